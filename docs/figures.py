"""Draw all figures of `pinmobile.plots` at 3.5 and 7 inches, in colour and in grey, side by side in one page.

Run by hand: ``python docs/figures.py out/figures.html``.
"""

from __future__ import annotations

import base64
import sys
from collections.abc import Callable
from functools import cache, partial
from html import escape
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure
from PIL import Image

from pinmobile import (
    PD,
    Backstepping,
    Circle,
    ComputedTorque,
    ConstantForce,
    Coulomb,
    Engine,
    Ensemble,
    FixedHeading,
    Hold,
    Log,
    MeasurementDelay,
    MobileRobot,
    Normal,
    Rollout,
    Spline,
    Tangent,
    UnicycleTracking,
    Uniform,
    WheeledRobot,
    WheelTable,
    WholeBody,
    ensemble,
    excitation,
    identify,
    plots,
    rk4,
    simulate,
)
from pinmobile.accuracy import integrator_report
from pinmobile.controllers import Decoupled
from pinmobile.derivatives import Poles, Sensitivities, poles, sensitivities
from pinmobile.identification import Prediction
from pinmobile.integrators import semi_implicit_euler
from pinmobile.wheels import OdometryFeedback

WIDTHS = 3.5, 7.0
"""Of one column of a paper and of both [in]."""

LETTERS = {"font.size": 8.0, "figure.titlesize": 9.0, "lines.linewidth": 1.1}
"""Of a paper."""


@cache
def circle() -> dict[str, Rollout]:
    """Return two controllers on the lecture's circle."""
    robot, way = MobileRobot.lecture(), Tangent(Circle(3, 0.1, 60))
    laws = {"PD": PD([120, 120, 0.4], [120, 120, 0.4]), "computed torque": ComputedTorque(robot)}
    return {name: simulate(robot, law, way, dt=0.1) for name, law in laws.items()}


@cache
def arm() -> dict[str, Rollout]:
    """Return two controllers of an arm on a base."""
    robot = MobileRobot.box(mass=60, size=(0.8, 0.6, 0.3)).mount("ur5", at=(0.2, 0, 0.3, 0))
    bend = Spline([[0.0] * 6, [-0.5] * 6, [0.0] * 6], [0, 1.5, 3])
    motion = WholeBody(robot, Tangent(Circle(radius=1, rate=0.5, duration=3)), bend)
    laws = {"computed torque": ComputedTorque(robot, 100, 20), "decoupled": Decoupled(robot, 100, 20)}
    return {name: simulate(robot, law, motion, dt=0.01, integrator=rk4) for name, law in laws.items()}


@cache
def wheels() -> dict[str, Rollout]:
    """Return a differential drive that rolls, and one that slips, both by what odometry believes."""
    own = {"mass": 1.0, "spin_inertia": 0.005, "yaw_inertia": 0.003, "supports": [(0.25, 0), (-0.25, 0)]}
    table, believed = (WheelTable.differential(0.46, radius, **own) for radius in (0.1, 0.099))
    box = MobileRobot(30.0, 1.3, com=(0.0, 0.0, 0.1), size=(0.6, 0.4, 0.25))
    rolling, slipping = WheeledRobot(box, table), WheeledRobot(box, table, Coulomb(0.3))
    law = OdometryFeedback(Backstepping(UnicycleTracking(), rolling), believed)
    way = Tangent(Circle(1, 0.5, 3))
    return {"rolls": simulate(rolling, law, way, dt=0.02), "slips": simulate(slipping, law, way, dt=0.02)}


@cache
def many() -> dict[str, Ensemble]:
    """Return three hundred robots by each of two controllers."""
    robot, way = MobileRobot(30, 1.3), Tangent(Circle(3, 0.1, 20))
    spread = {"mass": Uniform(24, 36), "force.x": Normal(0, 0.04), "com.x": Uniform(-0.05, 0.05)}
    laws = {"PD": PD([120, 120, 5.2], [120, 120, 5.2]), "computed torque": ComputedTorque(robot)}
    wind = [ConstantForce((0, 0, 0))]
    return {
        name: ensemble(robot, law, way, n=300, spread=spread, forces=wind, dt=0.1, engine=Engine.COMPILED)
        for name, law in laws.items()
    }


@cache
def reports() -> dict[str, Any]:
    """Return what two integrators are worth."""
    return {"rk4": integrator_report(rk4), "semi-implicit Euler": integrator_report(semi_implicit_euler)}


@cache
def foretold() -> Prediction:
    """Return what a robot identified from its log foretells of it."""
    robot = MobileRobot(mass=30, yaw_inertia=1.3)
    run = simulate(robot, ComputedTorque(robot, 16, 8), excitation(robot, duration=40), dt=0.02)
    log = Log.from_rollout(run, noise=1e-3)
    return identify(log, method="weak").predict(log)


@cache
def near() -> dict[str, Poles]:
    """Return the poles of loops with delayed measurements."""
    robot, rest = MobileRobot(mass=30, yaw_inertia=1.3), FixedHeading(Hold((0, 0), 1), 0)
    law = ComputedTorque(robot, 100, 20)
    return {f"{10 * k} ms late": poles(robot, MeasurementDelay(law, k), rest, dt=0.01) for k in (2, 6)}


@cache
def uncertain() -> Sensitivities:
    """Return the derivatives of a run by numbers that are not known exactly."""
    robot, law = MobileRobot(30, 1.3, com=(0.1, 0.05)), ComputedTorque(MobileRobot(25, 1.0), 4, 4)
    return sensitivities(robot, law, Tangent(Circle(2, 0.5, 6)), by=["plant.mass", "plant.com.x"], dt=0.02)


_GAINS = "gain", "1/s²", [1, 2, 4, 8]
_ERRORS = {
    "PD": [8.0, 5.0, 4.0, 3.8],
    "computed torque": [4.0, 2.0, 1.2, np.inf],
    "adaptive": [3.0, 1.0, 0.7, 0.6],
}

FIGURES: dict[str, Callable[..., Figure]] = {
    "path": lambda **how: plots.path(circle(), **how),
    "states": lambda **how: plots.states(circle(), **how),
    "states of an arm": lambda **how: plots.states(arm(), **how),
    "errors": lambda **how: plots.errors(circle(), **how),
    "errors of an arm": lambda **how: plots.errors(arm(), **how),
    "forces": lambda **how: plots.forces(circle(), **how),
    "signals": lambda **how: plots.signals(wheels()["rolls"], **how),
    "balance": lambda **how: plots.balance(arm(), **how),
    "reaction": lambda **how: plots.reaction(arm(), **how),
    "end_effector": lambda **how: plots.end_effector(arm(), **how),
    "prediction": lambda **how: plots.prediction(foretold(), **how),
    "wheel_torques": lambda **how: plots.wheel_torques(wheels(), **how),
    "friction": lambda **how: plots.friction(wheels(), **how),
    "slip": lambda **how: plots.slip(wheels(), **how),
    "loads": lambda **how: plots.loads(wheels(), **how),
    "odometry": lambda **how: plots.odometry(wheels(), **how),
    "bands": lambda **how: plots.bands(many(), **how),
    "drivers": lambda **how: plots.drivers(many()["computed torque"], **how),
    "heatmap": lambda **how: plots.heatmap(
        [[1.0, 2.0, 3.0, 5.0], [1.5, 4.0, 40.0, np.inf]],
        **{"x": _GAINS, "y": ("speed", "", ["slow", "fast"]), "label": "99 % stay within [mm]"} | how,
    ),
    "curves": lambda **how: plots.curves(_ERRORS, **{"x": _GAINS, "label": "99 % stay within [mm]"} | how),
    "integrator": lambda **how: plots.integrator(reports(), **how),
    "poles": lambda **how: plots.poles(near(), **how),
    "sensitivities": lambda **how: plots.sensitivities(uncertain(), {"mass": 1.5, "com.x": 0.02}, **how),
}
"""Each figure by name: a function of `ax` and `width`."""


def page(dpi: int = 100) -> str:
    """Return the page, of figures with this many pixels per inch."""
    body = []
    for name, draw in FIGURES.items():
        body.append(f"<h2>{escape(name)}</h2>")
        for width in WIDTHS:
            picture = _picture(partial(draw, width=width), dpi)
            shown = "".join(_image(each, f"{name}, {width:g} in") for each in (picture, picture.convert("L")))
            body.append(f"<p>{shown}</p>")
    return _PAGE.format(body="\n".join(body))


def _picture(draw: Callable[[], Figure], dpi: int) -> Image.Image:
    with rc_context(LETTERS):
        buffer = BytesIO()
        draw().savefig(buffer, format="png", dpi=dpi)
    return Image.open(buffer).convert("RGB")


def _image(picture: Image.Image, what: str) -> str:
    buffer = BytesIO()
    picture.save(buffer, "PNG", optimize=True)
    data = base64.b64encode(buffer.getvalue()).decode()
    return f'<img src="data:image/png;base64,{data}" alt="{escape(what)}" width="{picture.width}">'


_PAGE = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<title>Figures at 3.5 and 7 inches, in colour and in grey</title>
<style>
body {{ font: 16px/1.5 system-ui, sans-serif; color: #222; margin: 1rem; }}
img {{ margin-right: 1rem; border: 1px solid #ddd; vertical-align: top; }}
p {{ white-space: nowrap; }}
</style>
</head>
<body>
<h1>Figures at 3.5 and 7 inches, in colour and in grey</h1>
{body}
</body>
</html>
"""

if __name__ == "__main__":
    file = Path(sys.argv[1] if len(sys.argv) > 1 else "out/figures.html")
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(page(), encoding="utf-8")
    print(f"open {file}")
