"""Pictures of a page, by a headless Chromium."""

import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path

from PIL import Image

from pinmobile.arrays import whole
from pinmobile.errors import InvalidArgument, shown
from pinmobile.files import write
from pinmobile.viewer.chromium import Browser

__all__ = ["Progress", "checked_size", "picture_of", "pictures_of"]

Progress = Callable[[int, int], object]


def checked_size(size: tuple[int, int]) -> tuple[int, int]:
    """Return width and height [px], at least 16 each.

    Raises
    ------
    InvalidArgument
        If they are something else.
    """
    try:
        width, height = size
    except (TypeError, ValueError):
        raise InvalidArgument(f"size is {shown(size)}, expected width and height") from None
    return whole("size[0]", width, least=16), whole("size[1]", height, least=16)


def picture_of(html: str, size: tuple[int, int], time: float) -> bytes:
    """Return a page at a time, as a PNG.

    Parameters
    ----------
    html : str
        The page, as `recorded_page` makes it.
    size : tuple of 2 int
        Width and height [px].
    time : float
        From the rollout's start [s].

    Raises
    ------
    InvalidArgument
        If the size is none.
    ViewerError
        If there is no Chromium, or it fails.
    """
    with _opened(html, size) as browser:
        return _picture(browser, time)


def pictures_of(
    html: str, size: tuple[int, int], times: Sequence[float], progress: Progress | None
) -> Iterator[Image.Image]:
    """Yield a page at some times; other parameters and errors are those of `picture_of`.

    Parameters
    ----------
    html, size
        As in `picture_of`.
    times : sequence of float
        From the rollout's start [s].
    progress : callable or None
        Called as ``progress(done, total)`` after each picture.
    """
    with _opened(html, size) as browser:
        for done, time in enumerate(times, start=1):
            yield Image.open(BytesIO(_picture(browser, time)))
            if progress is not None:
                progress(done, len(times))


def _picture(browser: Browser, time: float) -> bytes:
    browser.evaluate(f"pinmobile.seek({float(time)!r})")
    return browser.picture()


@contextmanager
def _opened(html: str, size: tuple[int, int]) -> Iterator[Browser]:
    with tempfile.TemporaryDirectory(prefix="pinmobile-") as folder:
        page = Path(folder) / "page.html"
        write(page, html.encode("utf-8"), name="the page to be drawn")
        with Browser(checked_size(size)) as browser:
            browser.open(page.as_uri())
            browser.wait_for("pinmobile.ready()")
            browser.evaluate("document.body.classList.add('bare')")
            yield browser
