"""`benchmark`: controllers side by side where their model is wrong, with what each costs."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

from pinmobile.arrays import callable_as
from pinmobile.benchmarking.judgement import Benchmark, Score, scored
from pinmobile.benchmarking.situation import NOMINAL, BenchmarkScenario
from pinmobile.controllers import (
    ADRC,
    LQR,
    MPC,
    PD,
    PID,
    Adaptive,
    ComputedTorque,
    Controller,
    DisturbanceObserver,
    SlidingMode,
    SuperTwisting,
    check_controller,
    solver,
)
from pinmobile.errors import InvalidArgument, PinmobileError, shown
from pinmobile.forces import ConstantForce, Payload, RollingResistance, ViscousFriction
from pinmobile.paths import Polyline
from pinmobile.robot import MobileRobot
from pinmobile.trajectories import FixedHeading

__all__ = [
    "CORRIDOR",
    "NOMINAL",
    "STANDARD",
    "Benchmark",
    "BenchmarkScenario",
    "Score",
    "benchmark",
    "contestants",
]

_HEAVY = MobileRobot(36.0, 1.56, (0.1, 0.05))
_RUBBING = ViscousFriction((10.0, 20.0, 2.0)), RollingResistance((6.0, 9.0, 1.0), 0.01)
_PAYLOAD = Payload(10.0, (0.25, 0.1), 15.0)

STANDARD: Mapping[str, BenchmarkScenario] = MappingProxyType(
    {
        "nominal": BenchmarkScenario(about="what controllers believe is true"),
        "mass +20 %": BenchmarkScenario(robot=_HEAVY, about="36 kg instead of 30, inertia likewise"),
        "mass -20 %": BenchmarkScenario(
            robot=MobileRobot(24.0, 1.04, (0.1, 0.05)), about="24 kg instead of 30, inertia likewise"
        ),
        "com off": BenchmarkScenario(
            robot=MobileRobot(30.0, 1.3, (0.2, -0.05)), about="centre of mass 14 cm from where it should be"
        ),
        "payload": BenchmarkScenario(forces=[_PAYLOAD], event=15.0, about="10 kg are picked up at 15 s"),
        "push": BenchmarkScenario(
            forces=[ConstantForce((0.0, -25.0, 0.0), 10.0)], event=10.0, about="25 N from 10 s on"
        ),
        "friction": BenchmarkScenario(forces=_RUBBING, about="viscous friction and rolling resistance"),
        "delay": BenchmarkScenario(robot=_HEAVY, delay=3, about="measured 30 ms late; 36 kg"),
        "noise": BenchmarkScenario(robot=_HEAVY, noise=1e-3, about="noise of 1 mm, 1 cm/s; 36 kg"),
        "limits": BenchmarkScenario(
            limits=(22.0, 22.0, 3.0),
            offset=(-0.3, -0.5, 0.4),
            band=0.02,
            about="at most 22 N and 3 N m; starts 0.6 m off",
        ),
        "all": BenchmarkScenario(
            robot=MobileRobot(36.0, 1.3, (0.15, 0.0)),
            forces=[*_RUBBING, _PAYLOAD, ConstantForce((0.0, -40.0, 0.0), 22.0, 24.0)],
            delay=1,
            noise=1e-3,
            event=24.0,
            about="36 kg, centre of mass, friction, payload, noise, 10 ms, 40 N from 22 to 24 s",
        ),
    }
)
"""The standard scenarios, by name: what `NOMINAL` is not, on a circle at 0.9 m/s."""

_TALL = MobileRobot(36.0, 1.56, (0.1, 0.05, 1.0), size=(0.6, 0.5, 1.6))
_CORNER: dict[str, Any] = {
    "robot": _TALL,
    "trajectory": FixedHeading(Polyline([[0, 0], [3, 0], [3, 3]], 0.5, 10.0), 0.0),
    "offset": (-2.5, -1.0, 0.0),
    "upper": (3.1, 4.0),
    "after": 8.0,
}
CORRIDOR: Mapping[str, BenchmarkScenario] = MappingProxyType(
    {
        "corridor": BenchmarkScenario(
            **_CORNER, about="2.5 m late for a corner, whose wall is 10 cm beyond the path; tall, 36 kg"
        ),
        "corridor, 30 N": BenchmarkScenario(
            **_CORNER,
            limits=(30.0, 30.0, 5.0),
            about="the same with at most 30 N, so that the tip-over margin stays 8 cm",
        ),
        "corridor, narrower": BenchmarkScenario(
            **_CORNER | {"offset": None, "upper": (2.9, 4.0)},
            limits=(30.0, 30.0, 5.0),
            about="in time, but with a wall 10 cm before the path, which knows nothing of it",
        ),
    }
)
"""A tall robot that is late for a corner of a corridor: it may tip over, or brake too late for the wall.

In the last one it is in time, and the path itself leads through a wall.
"""


def contestants() -> dict[str, Any]:
    """Return the controllers of the library that believe in `NOMINAL`, by name, with their usual gains.

    MPC is among them where daqp is installed.
    """
    torque = ComputedTorque(NOMINAL, 16.0, 8.0)
    gain = (120.0, 120.0, 6.0)
    found: dict[str, Any] = {
        "PD": PD(120.0, 120.0),
        "computed torque": torque,
        "PID": PID(NOMINAL),
        "adaptive": Adaptive(NOMINAL, kd=gain),
        "adaptive, friction": Adaptive(NOMINAL, kd=gain, friction=True),
        "sliding mode": SlidingMode(NOMINAL),
        "super-twisting": SuperTwisting(NOMINAL),
        "observer": DisturbanceObserver(torque, NOMINAL),
        "ADRC": ADRC(NOMINAL),
        "LQR": LQR(NOMINAL),
    }
    return found if "MPC" in lacking() else found | {"MPC": MPC(NOMINAL)}


def lacking() -> dict[str, InvalidArgument]:
    """Return what `contestants` leaves out, by name, and the errors that say what it lacks."""
    try:
        solver()
    except InvalidArgument as error:
        return {"MPC": error}
    return {}


def benchmark(
    controllers: Mapping[str, Controller],
    scenarios: Mapping[str, BenchmarkScenario] = STANDARD,
    *,
    progress: Callable[[int, int], object] | None = None,
) -> Benchmark:
    """Run each controller in each scenario, and judge what it does and costs.

    Latency costs every controller speed times latency, unless it predicts: the reference has gone on. Chatter
    and force stand beside distances, since what switches buys the one by the other. Compiled where a law can
    be; a call is timed as NumPy runs it, which is what a robot's computer would do.

    With the settings of `contestants`, distances in `STANDARD` are those of an independent implementation to
    2 %, or half a unit of the last digit, but for

    - the adaptive law with friction, up to 27 % more, and 41 % less where there is friction: bounds of its
      estimates and the speed of its friction had not been stated, and are chosen here;
    - noise, which is drawn: over twelve seeds super-twisting comes within 1.55 to 2.50 mm and ADRC within
      1.65 to 2.10 mm, where 1.65 and 1.73 mm had been found; all others within 15 %;
    - MPC, which had a horizon of 20 steps of 0.01 s: with these, it is so too.

    Parameters
    ----------
    controllers : mapping of str to controller
        By name; of the standard scenarios they should believe in `NOMINAL`.
    scenarios : mapping of str to BenchmarkScenario
        By name.
    progress : callable, optional
        Called as ``progress(done, total)`` after each run.

    Returns
    -------
    Benchmark
        It prints as tables and who wins where; see `plots.benchmark`.

    Raises
    ------
    InvalidArgument
        If there is no controller or no scenario, or as in `simulate`; then its message, as that of all errors
        of pinmobile, says of which controller and scenario. What else a controller raises has a note of it.
    """
    for name, given, kind in (
        ("controllers", controllers, "controller"),
        ("scenarios", scenarios, "scenario"),
    ):
        if not isinstance(given, Mapping) or not given or not all(isinstance(key, str) for key in given):
            raise InvalidArgument(f"{name} is {shown(given)}, expected a mapping of names to {kind}s")
    for name, scenario in scenarios.items():
        if not isinstance(scenario, BenchmarkScenario):
            raise InvalidArgument(f"scenarios[{name!r}] is {shown(scenario)}, expected a BenchmarkScenario")
    for name, controller in controllers.items():
        try:
            check_controller(controller)
        except InvalidArgument as error:
            raise error.calling(f"controllers[{name!r}]") from None
    if progress is not None:
        callable_as("progress(done, total)", progress)
    scores: dict[str, dict[str, Score]] = {name: {} for name in controllers}
    total, done = len(controllers) * len(scenarios), 0
    for name, controller in controllers.items():
        for place, scenario in scenarios.items():
            whose = f"of controllers[{name!r}] in scenarios[{place!r}]"
            try:
                scores[name][place] = scored(scenario, controller)
            except PinmobileError as error:
                error.args = f"{error} ({whose})", *error.args[1:]
                raise
            except Exception as error:
                error.add_note(whose)
                raise
            done += 1
            if progress is not None:
                progress(done, total)
    return Benchmark(scores, dict(scenarios))
