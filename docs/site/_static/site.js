// Names for links whose text a style sheet hides, and keyboard focus for formulas that scroll.
document.addEventListener("DOMContentLoaded", () => {
  for (const link of document.querySelectorAll(".sphx-glr-thumbcontainer a.reference.internal")) {
    link.setAttribute("aria-label", link.textContent);
  }
  const drawn = window.MathJax?.startup?.promise ?? Promise.resolve();
  drawn.then(() => {
    for (const formula of document.querySelectorAll('mjx-container[display="true"]')) {
      if (formula.scrollWidth > formula.clientWidth) formula.tabIndex = 0;
    }
  });
});
