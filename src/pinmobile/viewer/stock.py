"""Meshcat as it is published: the one place that imports it, and where its page's script lies."""

import warnings
from pathlib import Path

with warnings.catch_warnings():
    # Its client imports parts of zmq that zmq warns about.
    warnings.simplefilter("ignore", DeprecationWarning)
    import meshcat
    import umsgpack

__all__ = ["ENGINE", "Visualizer", "packed_array", "packed_command"]

Visualizer = meshcat.Visualizer
packed_array = meshcat.geometry.pack_numpy_array
packed_command = umsgpack.packb

ENGINE = Path(meshcat.__file__).parent / "viewer" / "dist" / "main.min.js"
"""Meshcat's viewer with three.js in it."""
