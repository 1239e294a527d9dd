"""Build the site: `python docs/build.py [FOLDER]`; default: out/site. Nothing is loaded from the network.

It copies docs/site, adds the pages that it makes from the code, the notebooks and the changelog, lets Sphinx
write the pages, and checks each link.
"""

import gc
import importlib.metadata
import json
import os
import re
import shutil
import sys
import time
from base64 import b64decode
from collections.abc import Callable, Iterator
from functools import cache
from html.parser import HTMLParser
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(ROOT / "docs"), str(ROOT / "docs" / "site" / "_ext")]

from public import TOPICS, public, spelled  # noqa: E402


def write(path: Path, *lines: str) -> None:
    """Write a page."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join(lines) + "\n")


def first_sentence(something: object) -> str:
    """Return the first paragraph of a docstring on one line."""
    return " ".join((something.__doc__ or "").split("\n\n")[0].split()).replace("|", "\\|")


def reference(source: Path) -> None:
    """Write a page per topic, with a page per public name."""
    for topic, (title, modules) in TOPICS.items():
        lines = [title, "=" * len(title), ""]
        for module in modules:
            top, rest = [], []
            for name in public(module):
                (rest if "." in spelled(module, name) else top).append(
                    f"   pinmobile.{spelled(module, name)}"
                )
            for heading, names in (
                ("In pinmobile" if len(modules) == 1 else f"In pinmobile: {module}", top),
                (f"In pinmobile.{module}", rest),
            ):
                if names:
                    lines += [
                        heading,
                        "-" * len(heading),
                        "",
                        ".. autosummary::",
                        "   :toctree: generated",
                        "",
                    ]
                    lines += [*names, ""]
        write(source / "reference" / f"{topic}.rst", *lines)
    pages = [*TOPICS, "conventions", "scenario-keys", "command", "tables", "error-promises"]
    write(source / "reference" / "index.md", "# Reference", "", *listing(pages))


def listing(pages: list[str], hidden: bool = False) -> list[str]:
    """Return a table of contents."""
    return ["```{toctree}", *([":hidden:"] if hidden else [":maxdepth: 1"]), "", *pages, "```"]


def tables(source: Path) -> None:
    """Write what the code states: controllers with their numbers, drives, what can be mounted, scenarios."""
    import pinmobile
    from pinmobile.cli.scenario_file import shipped_names
    from pinmobile.parts import names_of, parameters

    def numbers(kind: type) -> str:
        found = [(name, each.declared) for name, each in parameters(kind).items()]
        units = [(name, getattr(declared, "unit", "")) for name, declared in found]
        return ", ".join(f"`{name}`" + (f" [{unit}]" if unit else "") for name, unit in units)

    lines = ["# Tables", "", "Made from the code.", "", "## Controllers", ""]
    lines += ["| controller | description | numbers |", "|---|---|---|"]
    for name in public("controllers"):
        kind = getattr(pinmobile.controllers, name)
        if isinstance(kind, type) and name in names_of(pinmobile.controllers.Controller):
            lines.append(f"| `{spelled('controllers', name)}` | {first_sentence(kind)} | {numbers(kind)} |")
    lines += ["", "## Drives of a wheel table", "", "| drive | description |", "|---|---|"]
    for name, value in vars(pinmobile.WheelTable).items():
        if isinstance(value, classmethod) and name[0] != "_":
            lines.append(f"| `WheelTable.{name}` | {first_sentence(value.__func__)} |")
    lines += ["", "## Robots that can be mounted", "", "```text", str(pinmobile.robot.mountable()), "```"]
    lines += [
        "",
        "## Shipped scenarios",
        "",
        "`pinmobile run NAME` runs one, `pinmobile write NAME` prints it.",
        "",
    ]
    lines += [f"- `{name}`" for name in shipped_names()]
    write(source / "reference" / "tables.md", *lines)


def scenario_keys(source: Path) -> None:
    """Write the keys of scenario files, with meaning and unit: those of the scenario, and of each part."""
    from pinmobile.cli.scenario_file import describe_part, list_parts

    rows = [line.split() for line in list_parts().splitlines() if line.startswith("  ")]
    lines = [
        "# Keys of scenario files",
        "",
        "`pinmobile parts NAME` prints one of these; `pinmobile parts` lists all.",
        "",
    ]
    for name in ("scenario", *(row[0] for row in rows)):
        lines += [f"## {name}", "", "```text", describe_part(name), "```", ""]
    write(source / "reference" / "scenario-keys.md", *lines)


def command(source: Path) -> None:
    """Write the help of each verb."""
    import typer

    from pinmobile.cli.verbs import app

    def helped(verb: Any, context: Any) -> list[str]:
        """Return the help of a verb, and of the verbs below it."""
        path = context.command_path
        lines = [
            f"{'#' if path == 'pinmobile' else '##'} {path}",
            "",
            "```text",
            verb.get_help(context).rstrip(),
            "```",
            "",
        ]
        for name, each in getattr(verb, "commands", {}).items():
            lines += helped(each, typer.Context(each, info_name=name, parent=context))
        return lines

    group = typer.main.get_command(app)
    write(source / "reference" / "command.md", *helped(group, typer.Context(group, info_name="pinmobile")))


def about(source: Path) -> None:
    """Write the pages of files of the project."""
    for name in ("CHANGELOG", "CONTRIBUTING"):
        text = (ROOT / f"{name}.md").read_text()
        text = re.sub(r"\]\((?!http|#)([^)]*)\)", lambda found: f"]({relocated(found[1])})", text)
        text = re.sub(r"\[(`?[^]`]+`?)\]\(NONE\)", r"\1", text)
        write(source / "about" / f"{name.lower()}.md", text)
    pages = [page.stem for page in sorted((source / "about").glob("*.md"))]
    write(source / "about" / "index.md", "# About", "", *listing(pages))


def relocated(link: str) -> str:
    """Return where a link of a file of the project leads on the site; NONE: nowhere."""
    path, _, place = link.partition("#")
    path = path.removeprefix("./")
    if path.startswith("docs/site/"):
        return "../" + path.removeprefix("docs/site/") + (f"#{place}" if place else "")
    known = {"CONTRIBUTING.md": "../about/contributing.md", "CHANGELOG.md": "../about/changelog.md"}
    if path.startswith("notebooks/"):
        return "../tutorials/" + path.removeprefix("notebooks/")
    return known.get(path, "NONE")


def notebooks(source: Path) -> None:
    """Copy the notebooks, with the last figure of each for its card."""
    (source / "tutorials" / "pictures").mkdir()
    for file in sorted((ROOT / "notebooks").glob("[0-9]*.ipynb")):
        notebook = json.loads(file.read_text())
        outputs = [each for cell in notebook["cells"] for each in cell.get("outputs", ())]
        pictures = [each["data"]["image/png"] for each in outputs if "image/png" in each.get("data", {})]
        picture = source / "tutorials" / "pictures" / f"{file.stem}.png"
        picture.write_bytes(b64decode("".join(pictures[-1])))
        words = f"{{download}}`Download this notebook <{file.name}>` to run it."
        cell = {"cell_type": "markdown", "id": "download", "metadata": {}, "source": words}
        notebook["cells"].insert(1, cell)
        (source / "tutorials" / file.name).write_text(json.dumps(notebook))


def recordings(folder: Path) -> None:
    """Record what the pages show: a page and its still picture each."""
    from recording import save

    from pinmobile import (
        PD,
        Backstepping,
        Circle,
        ComputedTorque,
        MobileRobot,
        Spline,
        Tangent,
        UnicycleTracking,
        WheeledRobot,
        WheelTable,
        WholeBody,
        rk4,
        simulate,
    )
    from pinmobile.viewer import Viewer

    def record(name: str, robot: object, runs: object, t: float, speed: float = 1.0) -> None:
        with Viewer(robot) as viewer:
            save(viewer.record(runs, speed=speed), folder, name, t)

    robot = MobileRobot(mass=30, yaw_inertia=1.3, com=(0.1, 0.05))
    circle = Tangent(Circle(radius=3, rate=0.1, duration=60))
    rivals = {"PD": PD(120, 120), "computed torque": ComputedTorque(robot, kp=4, kd=4)}
    runs = {name: simulate(robot, each, circle, dt=0.01) for name, each in rivals.items()}
    record("circle", robot, runs, 12, speed=4)
    ur5 = MobileRobot.box(mass=60, size=(0.8, 0.6, 0.3)).mount("ur5", at=(0.2, 0, 0.3, 0))
    bend = Spline([[0.0] * 6, [-0.5] * 6, [0.0] * 6], [0, 3, 6])
    motion = WholeBody(ur5, Tangent(Circle(radius=1, rate=0.5, duration=6)), bend)
    record("ur5", ur5, simulate(ur5, ComputedTorque(ur5, kp=100, kd=20), motion, dt=0.005, integrator=rk4), 2)
    wheels = WheelTable.differential(track=0.5, radius=0.1, supports=[(0.3, 0)], mass=1.0, spin_inertia=0.005)
    rolling = WheeledRobot(MobileRobot(30.0, 1.3, com=(0.1, 0.05, 0.2)), wheels)
    law = Backstepping(UnicycleTracking(), rolling)
    record(
        "drive", rolling, simulate(rolling, law, Tangent(Circle(radius=1, rate=0.5, duration=10)), dt=0.01), 2
    )


def mathjax(folder: Path) -> None:
    """Copy the one script that draws formulas from its package."""
    files = importlib.metadata.files("sphinx-mathjax-offline") or ()
    script = next(each for each in files if each.as_posix().endswith("mathjax/tex-svg.js"))
    folder.mkdir(parents=True, exist_ok=True)
    shutil.copy(str(script.locate()), folder)


class Page(HTMLParser):
    """What a page links to and loads, and its places."""

    def __init__(self, text: str) -> None:
        super().__init__(convert_charrefs=True)
        self.ids: set[str] = set()
        self.links: list[str] = []
        self.loaded: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Take the addresses of an element."""
        given = {name: value for name, value in attrs if value}
        self.ids.update(given[key] for key in ("id", "name") if key in given)
        if tag == "a" and "href" in given:
            self.links.append(given["href"])
        self.loaded += [given["src"]] if "src" in given else []
        self.loaded += (
            [given["href"]] if tag == "link" and given.get("rel") != "canonical" and "href" in given else []
        )


def broken(html: Path) -> Iterator[str]:
    """Yield the dead links of a site, and the files that it loads from other hosts."""
    paths = [
        each
        for each in html.rglob("*.html")
        if not {"_static", "recordings"} & set(each.relative_to(html).parts)
    ]
    pages = {os.path.realpath(path): Page(path.read_text()) for path in paths}
    exists = cache(os.path.exists)
    for path, page in pages.items():
        for link in {*page.links, *page.loaded}:
            address = urlsplit(link)
            if address.scheme or address.netloc:
                if link in page.loaded and address.scheme != "data":
                    yield f"{path}: loads {link}"
                continue
            place = os.path.join(os.path.dirname(path), unquote(address.path))
            target = os.path.normpath(place) if address.path else path
            ids = pages[target].ids if target in pages else None
            if not exists(target) or (
                address.fragment and ids is not None and unquote(address.fragment) not in ids
            ):
                yield f"{path}: no {link}"


def timed(words: str, step: Callable[..., object], *given: object) -> object:
    """Print what is done, and how long it took."""
    print(f"{words} ...", end=" ", flush=True)
    start = time.perf_counter()
    result = step(*given)
    print(f"{time.perf_counter() - start:.0f} s", flush=True)
    return result


def main(folder: Path) -> int:
    """Build, check, and print the next step."""
    from sphinx.cmd.build import build_main

    source, html = folder / "source", folder / "html"
    os.environ["PINMOBILE_ROOT"] = str(ROOT)
    for old in ("source", "doctrees", "html"):
        shutil.rmtree(folder / old, ignore_errors=True)
    shutil.copytree(ROOT / "docs" / "site", source)
    shutil.copy(ROOT / "LICENSE", source)
    shutil.copytree(ROOT / "examples" / "ros2", source / "examples" / "ros2")
    for words, step in (
        ("reference", reference),
        ("command", command),
        ("tables", tables),
        ("keys", scenario_keys),
    ):
        timed(words, step, source)
    timed("notebooks", notebooks, source)
    timed("about", about, source)
    timed("formulas", mathjax, source / "_static" / "mathjax")
    timed("recordings", recordings, source / "_static" / "recordings")
    gc.freeze()
    gc.set_threshold(100_000)  # Sphinx allocates millions of nodes: the default takes a quarter of its time
    # One process: two hand pages to each other, which takes a quarter more, and no less time.
    code = build_main(
        ["-b", "html", "-n", "-W", "--keep-going", "-q", "-d", f"{folder}/doctrees", str(source), str(html)]
    )
    wrong = sorted(set(broken(html)))
    print(*wrong, sep="\n")
    pages = list(html.rglob("*.html"))
    size = sum(each.stat().st_size for each in html.rglob("*") if each.is_file())
    print(f"{len(pages)} pages, {size / 1e6:.0f} MB, {len(wrong)} wrong links; open {html / 'index.html'}")
    return int(bool(code or wrong))


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1] if len(sys.argv) > 1 else ROOT / "out" / "site").resolve()))
