"""Directive `recording`: the page of a recording behind a still picture; a reader's click loads it.

``.. recording:: NAME`` shows ``_static/recordings/NAME.png``; its button replaces the picture by a frame with
``NAME.html`` beside it. The browser does not ask for that page before. ``:title:`` is the caption, ``:alt:``
describes the picture; text in the directive follows the caption. `save` writes both files.
Style and script are ``_static/recording.css`` and ``_static/recording.js``.
"""

from html import escape
from io import BytesIO
from pathlib import Path
from typing import Any

from docutils import nodes
from docutils.parsers.rst import directives
from PIL import Image
from sphinx.application import Sphinx
from sphinx.util import logging
from sphinx.util.docutils import SphinxDirective
from sphinx.util.osutil import relative_uri

FOLDER = "_static/recordings"
SIZE = 720, 405  # of a still [px]
LARGEST = 60_000  # bytes of a still
MISSING = (
    "recording %s has no picture: the build found no Chromium that draws one; install it, or name it in "
    "PINMOBILE_CHROMIUM"
)

_logger = logging.getLogger(__name__)


def small_png(picture: Image.Image) -> bytes:
    """Return a picture as a PNG of at most 60 kB: with fewer colours, then with fewer pixels."""
    while True:
        for colours in (256, 128, 64, 32):
            file = BytesIO()
            few = picture.convert("RGB").quantize(colours, dither=Image.Dither.NONE)
            few.save(file, "PNG", optimize=True)
            if file.tell() <= LARGEST:
                return file.getvalue()
        picture = picture.resize((3 * picture.width // 4, 3 * picture.height // 4))


def save(recording: Any, folder: Path, name: str, t: float | None = None) -> bool:
    """Write page and still of a `pinmobile.viewer.Recording`.

    Parameters
    ----------
    recording : Recording
        What is written.
    folder : Path
        Where it is written: ``_static/recordings`` of the sources.
    name : str
        Name of the files, without their endings.
    t : float, optional
        Time of the still [s]; default: a third of the recording.

    Returns
    -------
    drawn : bool
        Whether there is a still. A headless Chromium draws it; without one, a warning says so.
    """
    from pinmobile.errors import ViewerError

    folder.mkdir(parents=True, exist_ok=True)
    still = folder / f"{name}.png"
    recording.save_html(folder / f"{name}.html")
    try:
        recording.screenshot(
            still, t=recording.duration / 3 if t is None else t, size=SIZE
        )
    except ViewerError:
        still.unlink(missing_ok=True)  # of an earlier build
        return False
    still.write_bytes(small_png(Image.open(BytesIO(still.read_bytes()))))
    return True


class Frame(nodes.General, nodes.Element):
    """A recorded page behind its picture; its children follow the caption."""


class Recording(SphinxDirective):
    """The directive."""

    required_arguments = 1
    has_content = True
    option_spec = {  # noqa: RUF012 - as docutils has it
        "title": directives.unchanged_required,
        "alt": directives.unchanged_required,
    }

    def run(self) -> list[nodes.Node]:
        """Return the frame; the page must be there."""
        name = self.arguments[0]
        page = Path(self.env.srcdir) / FOLDER / f"{name}.html"
        still = page.with_suffix(".png")
        if not page.exists():
            raise self.error(f"there is no recording {page}")
        if not still.exists():
            _logger.warning(
                MISSING,
                name,
                type="recording",
                subtype="still",
                location=self.get_location(),
            )
        self.env.note_dependency(str(page))
        title = self.options.get("title", name)
        size = Image.open(still).size if still.exists() else None
        frame = Frame(
            name=name,
            title=title,
            alt=self.options.get("alt", title),
            size=size,
            megabytes=page.stat().st_size / 1e6,
        )
        frame += self.parse_content_to_nodes()
        return [frame]


_PICTURE = (
    '<img src="{still}" alt="{alt}" width="{width}" height="{height}" loading="lazy">'
)
_NO_PICTURE = (
    '<p class="recording-none">No picture: the site was built without a browser.</p>'
)
_STAGE = """<figure class="recording">
<div class="recording-stage" data-src="{page}" data-title="{title}">
{picture}
<button type="button" class="recording-play" aria-label="Play: {title} ({megabytes:.1f} MB)" hidden>
<svg viewBox="0 0 24 24" width="24" height="24" aria-hidden="true"><path d="M7 4v16l13-8z"/></svg>
</button>
</div>
<figcaption><span class="recording-title">{title}</span>
<a href="{page}">Open on a page of its own</a> ({megabytes:.1f} MB)
"""


def visit_html(self: Any, node: Frame) -> None:
    """Write picture, button and link."""
    here = self.builder.get_target_uri(self.builder.current_docname)
    page, still = (
        relative_uri(here, f"{FOLDER}/{node['name']}.{end}") for end in ("html", "png")
    )
    title, alt = escape(node["title"]), escape(node["alt"])
    width, height = node["size"] or SIZE
    picture = _PICTURE.format(still=still, alt=alt, width=width, height=height)
    picture = picture if node["size"] else _NO_PICTURE
    self.body.append(
        _STAGE.format(
            page=page, title=title, picture=picture, megabytes=node["megabytes"]
        )
    )


def depart_html(self: Any, node: Frame) -> None:
    """End the figure."""
    self.body.append("</figcaption>\n</figure>\n")


def visit_text(self: Any, node: Frame) -> None:
    """Write the title alone: nothing moves on paper."""
    self.add_text(node["title"])
    raise nodes.SkipNode


def skip(self: Any, node: Frame) -> None:
    """Write nothing."""
    raise nodes.SkipNode


def setup(app: Sphinx) -> dict[str, bool]:
    """Add the directive; `conf.py` adds its style and its script."""
    app.add_node(
        Frame,
        html=(visit_html, depart_html),
        text=(visit_text, None),
        latex=(skip, None),
    )
    app.add_directive("recording", Recording)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
