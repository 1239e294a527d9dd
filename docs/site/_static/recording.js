// A click on the button of a recording loads its page into a frame. Nothing is requested before.
"use strict";
document.addEventListener("DOMContentLoaded", () => {
  for (const button of document.querySelectorAll(".recording-play")) {
    button.hidden = false; // without this script it would do nothing
    button.addEventListener("click", () => {
      const stage = button.parentElement;
      const frame = document.createElement("iframe");
      frame.title = stage.dataset.title;
      frame.setAttribute("sandbox", "allow-scripts"); // no origin, no forms, no windows
      frame.referrerPolicy = "no-referrer";
      frame.src = stage.dataset.src;
      stage.classList.add("recording-playing");
      stage.replaceChildren(frame);
      frame.focus();
    });
  }
});
