"""Loops and controllers of `benchmarks/controllers.py`, which prints them beside published numbers."""

import sys
from importlib import import_module
from pathlib import Path
from typing import Any

from pinmobile import MobileRobot, Tangent

sys.path.insert(0, str(Path(__file__).parents[1] / "benchmarks"))
published: Any = import_module("controllers")

NOMINAL: MobileRobot = published.NOMINAL
HEAVY: MobileRobot = published.HEAVY
OFF: MobileRobot = published.OFF
CIRCLE: Tangent = published.CIRCLE
RIVALS: dict[str, Any] = {name: one for name, one in published.rivals().items() if "MPC" not in name}
