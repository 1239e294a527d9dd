"""Execute the notebooks' sources and write the paired .ipynb files, with their outputs.

Run as `make notebooks`, or `python notebooks/execute.py 03 04` for some of them.
"""

import sys
from base64 import b64decode, b64encode
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import jupytext
import nbformat
from nbclient import NotebookClient
from PIL import Image
from traitlets.config import Config

from pinmobile.files import write

HERE = Path(__file__).parent


def execute(source: Path) -> None:
    """Execute one source in a fresh kernel and write the notebook beside it."""
    notebook = jupytext.read(source)
    # Nothing that depends on the day or the machine: what did not change is not written differently.
    notebook.metadata = {
        "kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"},
        "language_info": {"name": "python"},
    }
    for number, cell in enumerate(notebook.cells, 1):
        cell["id"] = f"cell-{number:02}"
    with TemporaryDirectory() as folder:
        # Sockets in a folder of their own: a TCP port is taken by another program now and then.
        config = Config(KernelManager={"transport": "ipc", "ip": f"{folder}/kernel"})
        where = {"metadata": {"path": str(HERE)}}
        client = NotebookClient(notebook, timeout=300, resources=where, config=config)
        client.record_timing, client.coalesce_streams = False, True
        client.execute()
    for cell in notebook.cells:
        for output in cell.get("outputs", ()):
            data = output.get("data", {})
            if "scene" in cell.metadata.get("tags", ()):
                still(data, source)
            shrink(data)
    notebook.metadata["language_info"] = {"name": "python"}
    target = source.with_suffix(".ipynb")
    write(target, nbformat.writes(notebook).encode("utf-8"))
    print(f"{target.name}: {target.stat().st_size / 1000:.0f} kB")


def still(data: dict[str, Any], source: Path) -> None:
    """Keep the picture of an animated scene, not the page that plays it: that has a megabyte."""
    if data.pop("text/html", None) and "image/png" not in data:
        raise SystemExit(f"{source.name}: a scene has no picture: no Chromium was found to draw it")
    if "image/png" in data:
        data["text/plain"] = "the animated scene, when the notebook is run"


def shrink(data: dict[str, Any]) -> None:
    """Store a figure with a palette of 256 colours: as good to the eye, and a third of the size."""
    if "image/png" in data:
        buffer = BytesIO()
        picture = Image.open(BytesIO(b64decode(data["image/png"]))).convert("RGB")
        picture.quantize(256, dither=Image.Dither.NONE).save(buffer, "PNG", optimize=True)
        data["image/png"] = b64encode(buffer.getvalue()).decode()


if __name__ == "__main__":
    for path in sorted(HERE.glob("[0-9][0-9]_*.py")):
        if path.name.startswith(tuple(sys.argv[1:] or [""])):
            execute(path)
