"""Image scraper of sphinx-gallery: the figures and recordings that a script has in its global variables.

`pinmobile.plots` makes figures without pyplot, which sphinx-gallery's own scraper does not find.
"""

from pathlib import Path
from shutil import copy
from typing import Any
from weakref import WeakSet

from matplotlib.figure import Figure
from recording import FOLDER, save
from sphinx_gallery.scrapers import figure_rst

SEEN: dict[str, WeakSet[Any]] = {}
"""What each script has shown in earlier blocks."""


def scrape(
    block: tuple[Any, ...],
    block_vars: dict[str, Any],
    gallery_conf: dict[str, Any],
    **_: Any,
) -> str:
    """Save each new figure and recording, and return the text that shows them."""
    from pinmobile.viewer import Recording

    script = Path(block_vars["src_file"])
    names, paths = block_vars["example_globals"], block_vars["image_path_iterator"]
    seen, shown = SEEN.setdefault(str(script), WeakSet()), []
    for name, value in list(names.items()):
        if (
            name.startswith("_")
            or not isinstance(value, Figure | Recording)
            or value in seen
        ):
            continue
        seen.add(value)
        if isinstance(value, Figure):
            shown.append(figure_text(value, Path(next(paths)), gallery_conf["src_dir"]))
            continue
        folder, page = Path(gallery_conf["src_dir"]) / FOLDER, f"{script.stem}_{name}"
        if save(value, folder, page):  # a picture of the gallery too, for the thumbnail
            copy(folder / f"{page}.png", next(paths))
        shown.append(f"\n.. recording:: {page}\n   :title: {value.title}\n\n")
    return "".join(shown)


def figure_text(figure: Figure, path: Path, folder: str) -> str:
    """Save a figure and return its text, whose alternative text is the figure's title."""
    figure.savefig(path, dpi=120)
    title = figure.get_suptitle() or next(
        (text.get_text() for text in figure.texts if text.get_text()), ""
    )
    return str(figure_rst([str(path)], folder, fig_titles=title))
