"""The page that shows a scene: meshcat's own script, and what the stage adds to it."""

import base64
import json
import re
import warnings
from collections.abc import Iterable
from functools import cache
from hashlib import sha256
from html import escape
from importlib.resources import files
from pathlib import Path
from string import Template
from typing import Any

with warnings.catch_warnings():
    # Its client imports parts of zmq that zmq warns about.
    warnings.simplefilter("ignore", DeprecationWarning)
    import meshcat
    import umsgpack


Visualizer = meshcat.Visualizer
packed_array = meshcat.geometry.pack_numpy_array
packed_command = umsgpack.packb

ENGINE = Path(meshcat.__file__).parent / "viewer" / "dist" / "main.min.js"
"""Meshcat's viewer with three.js in it."""


# Meshcat's controls bring styles of their own, which have no hash that could be known.
_POLICY = (
    "default-src 'none'; script-src {0}; style-src 'unsafe-inline'; img-src data: blob:; base-uri 'none'; "
    "form-action 'none'"
)

_CONNECT = """<script>
viewer.connect();
</script>"""

_LOAD = """<script type="application/json" id="animation">$animation</script>
<script>
$loading
const animation = JSON.parse(document.getElementById("animation").textContent);
if (animation.tracks.length) pinmobile.play(animation.tracks, animation.speed, animation.end);
</script>"""


def live_page(title: str = "pinmobile") -> str:
    """Return the page that connects to the server it came from; it asks that for ``main.min.js``."""
    return _filled(title, '<script src="main.min.js"></script>', _CONNECT)


def recorded_page(title: str, commands: Iterable[bytes], animation: dict[str, Any]) -> str:
    """Return a page that holds everything it shows.

    Parameters
    ----------
    title : str
        Of the page.
    commands : iterable of bytes
        Meshcat's commands, as it sends them.
    animation : dict
        ``tracks`` (meshcat's animations), ``speed`` at first, and ``end``, the last time [s].
    """
    packed = json.dumps(animation, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")
    scene = Template(_LOAD).substitute(animation=packed, loading=loading(commands))
    return sealed(_filled(title, f"<script>\n{_engine()}\n</script>", scene))


def loading(commands: Iterable[bytes]) -> str:
    """Return the script that puts meshcat's commands into a scene."""
    texts = ",\n".join(f'"{base64.b64encode(command).decode()}"' for command in commands)
    return (
        f"for (const text of [\n{texts}\n]) viewer.handle_command_bytearray("
        "Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0)));"
    )


def sealed(page: str) -> str:
    """Return a page that holds everything it shows with a policy: its own scripts run, and ask for nothing.

    Parameters
    ----------
    page : str
        HTML, each of its scripts in a plain ``<script>``.
    """
    scripts = re.findall(r"<script>(.*?)</script>", page, re.DOTALL)
    hashes = (base64.b64encode(sha256(script.encode()).digest()).decode() for script in scripts)
    policy = _POLICY.format(" ".join(f"'sha256-{each}'" for each in dict.fromkeys(hashes)))
    tag = f'<meta http-equiv="Content-Security-Policy" content="{policy}">'
    return page.replace("<head>", f"<head>\n{tag}", 1)


def _filled(title: str, engine: str, scene: str) -> str:
    parts = {"css": _part("stage.css"), "stage": _part("stage.js"), "engine": engine, "scene": scene}
    return Template(_part("stage.html")).substitute(parts, title=escape(title))


@cache
def _part(name: str) -> str:
    return files("pinmobile.viewer").joinpath(name).read_text(encoding="utf-8").strip()


@cache
def _engine() -> str:
    return ENGINE.read_text(encoding="utf-8")
