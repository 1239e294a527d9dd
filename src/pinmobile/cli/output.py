"""Output of the command: console, progress bar, output folder and index page."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from html import escape
from importlib.resources import files
from io import BytesIO
from pathlib import Path
from string import Template
from tempfile import TemporaryFile
from threading import Event, Thread
from typing import TYPE_CHECKING

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

from pinmobile.errors import InvalidArgument
from pinmobile.files import file_errors, write

if TYPE_CHECKING:
    from matplotlib.figure import Figure

console = Console(highlight=False, markup=False, soft_wrap=True)
_MINUTE = 60.0  # [s]


@dataclass(frozen=True)
class Picture:
    """Figure on the index page: its file in the output folder, and its caption."""

    file: str
    caption: str


@dataclass(frozen=True)
class Section:
    """Section of the index page: title, text in a fixed-width font, links to pages, and figures."""

    title: str
    text: str = ""
    pictures: Sequence[Picture] = ()
    pages: Sequence[Picture] = ()


@contextmanager
def progress(total: int, name: str = "running") -> Iterator[Progress]:
    """Show a progress bar with one task of `total` steps; without a terminal, write a line per minute."""
    columns = SpinnerColumn(), TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn()
    hidden = not console.is_terminal  # rich would write an empty line
    with Progress(*columns, console=console, transient=True, disable=hidden) as bar:
        bar.add_task(name, total=total)
        task, stop = bar.tasks[0], Event()

        def write_lines() -> None:
            while not stop.wait(_MINUTE):
                share = f"{task.completed:,.0f} of {task.total or 0:,.0f}"
                with suppress(OSError, ValueError):  # nobody reads
                    typer.echo(f"{task.description}: {share}, {task.elapsed or 0:.0f} s", err=True)

        if not console.is_terminal:
            Thread(target=write_lines, daemon=True).start()
        try:
            yield bar
        finally:
            stop.set()


def begin(bar: Progress, name: str) -> None:
    """Advance a progress bar by one step, and show the name of the next step."""
    bar.update(bar.task_ids[0], description=name, advance=1)


_FILE_SUFFIXES = (".npz", ".csv", ".txt", ".html", ".png", ".gif", ".mp4", ".toml")


def output_folder(path: Path, option: str = "--out", given: Path | None = None) -> Path:
    """Return the output folder after a check that it can be written; create a missing folder.

    Parameters
    ----------
    path : Path
        Output folder.
    option : str
        Name of the option, for the message.
    given : Path, optional
        Value of the option, for the message; default: the folder.

    Raises
    ------
    InvalidArgument
        If the folder cannot be created or written, or the name of a missing folder is that of a file.
    FileError
        If the system fails, for example because the disk is full.
    """
    if given is None and path.suffix in _FILE_SUFFIXES and not path.exists():
        raise InvalidArgument(f"{option} is {str(path)!r}, expected a folder, such as {path.stem}")
    with file_errors("written to", option, given or path):
        path.mkdir(parents=True, exist_ok=True)
        TemporaryFile(dir=path).close()
    return path


def save_figure(figure: "Figure", path: Path) -> None:
    """Write a matplotlib figure as a PNG."""
    buffer = BytesIO()
    figure.savefig(buffer, format="png", dpi=110)
    write(path, buffer.getvalue())


def index_page(folder: Path, title: str, sections: Sequence[Section]) -> Path:
    """Write ``index.html`` with all figures and captions, and return its path."""
    body = []
    for section in sections:
        body.append(f"<h2>{escape(section.title)}</h2>")
        if section.text:
            body.append(f"<pre>{escape(section.text)}</pre>")
        for link in section.pages:
            body.append(f'<p><a href="{escape(link.file)}">{escape(link.caption)}</a></p>')
        for picture in section.pictures:
            file, caption = escape(picture.file), escape(picture.caption)
            element = f'<a href="{file}"><img src="{file}" alt="{caption}" loading="lazy"></a>'
            if picture.file.endswith(".mp4"):
                element = f'<video src="{file}" controls loop muted preload="metadata"></video>'
            body.append(f"<figure>{element}<figcaption>{caption}</figcaption></figure>")
    page = folder / "index.html"
    template = Template(files("pinmobile.cli").joinpath("page.html").read_text("utf-8"))
    write(page, template.substitute(title=escape(title), body="\n".join(body)).encode("utf-8"))
    return page
