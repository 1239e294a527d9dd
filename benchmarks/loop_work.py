"""What is timed of the loop of parts, by the pinmobile of the interpreter that runs this: `loop.py` asks.

Usage: python benchmarks/loop_work.py [--quick] [--least SECONDS] ROW ...

Prints, as JSON, the seconds of each row, or a word on why there are none. It uses what older versions have.
"""

import argparse
import json
import sys
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
from contestants import raw_pinocchio
from measuring import median_time, processor_seconds
from task import GAIN, PD_GAINS, RADIUS, RATE, Task

ROBOTS, QUICK_ROBOTS = 10_000, 100
STEPS, QUICK_STEPS = 1_200, 40
SHORT, LONGEST = 12, 1.0  # steps to begin with; ten times as many follow on what takes no longer [s]
SAMPLES = 6_001  # of a rollout
DT, FINE = 0.05, 0.01  # of an ensemble, of a rollout [s]


ENGINES = {"PYTHON": ("PYTHON", "PINOCCHIO"), "COMPILED": ("COMPILED",)}
"""What engines are called, in this version and in older ones."""

PRINTED = "\nfrom time import process_time\nprint()\nprint(process_time())\n"
FIRST_ENSEMBLE = """
from time import perf_counter as now
import pinmobile
from pinmobile import Circle, ComputedTorque, MobileRobot, Normal, Tangent, Uniform, ensemble
start, com = now(), "com.x" if hasattr(pinmobile, "parts") else "com_x"  # before parts, names had no dot
robot = MobileRobot(30.0, 1.3, com=(0.1, 0.0))
spread = {"mass": Uniform(20, 40), com: Normal(0.1, 0.02)}
trajectory = Tangent(Circle(3.0, 0.1, 60.0))
ensemble(robot, ComputedTorque(robot, 4, 4), trajectory, n=100, spread=spread, seed=0, dt=0.1)
print("\\n", now() - start, sep="")
"""
PLANAR = "import pinmobile as p; b = p.MobileRobot(30, 1.3, (0.1, 0.05)); "
FIRST_RESULTS = {
    "first result, planar": PLANAR + "p.simulate(b, p.ComputedTorque(b), p.Tangent(p.Circle(2, 0.5, 6)), "
    "dt=0.01, engine=p.Engine.COMPILED)",
    "first result, UR5": "import pinmobile as p; b = p.MobileRobot.box().mount('ur5'); "
    "t = p.WholeBody(b, p.Tangent(p.Circle(3, 0.1, 2)), p.Hold(b.rest[3:], 2)); "
    "p.simulate(b, p.ComputedTorque(b, 9, 6), t, dt=0.01, engine=p.Engine.COMPILED)",
    "first result, sliding wheels": "import numpy as np; "
    + PLANAR
    + "w = p.WheelTable.differential(0.5, 0.1, supports=[(-0.3, 0)], mass=1.0, spin_inertia=0.01, "
    "yaw_inertia=0.006); d = p.WheeledRobot(b, w, p.Coulomb()); "
    "p.simulate(d, p.law(lambda t, q, v, r: np.array([0.6, 0.7]) + 0 * v[:2]), "
    "p.Tangent(p.Circle(2, 0.5, 6)), dt=0.01, engine=p.Engine.COMPILED, limit=1e6)",
}
"""First results of a process, whose machine code is on disk: seconds from the start of Python."""


class Lacking(Exception):
    """What a row needs is not in a version."""


@dataclass(frozen=True)
class PID:
    """PID as a user writes it, with memory."""

    gains: np.ndarray = field(default_factory=PD_GAINS.copy)
    share: float = 0.1  # of the integral
    dt: float = DT

    def initial_state(self, context: Any) -> Any:
        """Return the integral of the error at first."""
        return np.zeros(3)

    def __call__(self, t: float, q: Any, v: Any, reference: Any, state: Any) -> Any:
        """Return the force and the integral."""
        error = reference.q - q
        state = state + self.dt * error
        return self.gains * (error + reference.v - v + self.share * state), state


@dataclass(frozen=True)
class SlidingMode:
    """A sliding mode as a user writes it, with a boundary layer."""

    gains: np.ndarray = field(default_factory=PD_GAINS.copy)
    slope: float = 1.0
    reach: float = 0.5
    width: float = 0.2

    def initial_state(self, context: Any) -> Any:
        """Return None: it has no memory."""
        return None

    def __call__(self, t: float, q: Any, v: Any, reference: Any, state: Any) -> Any:
        """Return the force and the memory."""
        surface = (reference.v - v) + self.slope * (reference.q - q)
        return self.gains * (self.reach * surface + self.width * np.tanh(surface / self.width)), state


_OLDER = {
    "InputSaturation": "Saturated",
    "MeasurementDelay": "Delayed",
    "MeasurementNoise": "NoisyMeasurement",
}


class Names:
    """The names of a version of pinmobile, wherever it has them, and what older ones call them."""

    def __init__(self, version: Any) -> None:
        self.places = version, getattr(version, "Engine", None)
        self.places += version.integrators, version.controllers, version.forces

    def __getattr__(self, name: str) -> Any:
        for known in (name, _OLDER.get(name, name)):
            for place in self.places:
                if hasattr(place, known):
                    return getattr(place, known)
        raise AttributeError(name)


class Work:
    """Robot, trajectory and loops of one size, and what they take."""

    def __init__(self, quick: bool, least: float) -> None:
        import pinmobile

        self.of: Any = Names(pinmobile)
        self.quick, self.least = quick, least
        self.robot = pinmobile.MobileRobot.lecture()
        self.computed = pinmobile.ComputedTorque(self.robot, kp=GAIN, kd=GAIN)
        start = "start.x" if hasattr(pinmobile, "parts") else "start_x"  # before parts, names had no dot
        self.spread = {"mass": pinmobile.Uniform(20, 40), start: pinmobile.Normal(0, 0.1)}

    def trajectory(self, duration: float) -> Any:
        """Return the circle, for some time [s]."""
        return self.of.Tangent(self.of.Circle(RADIUS, RATE, duration))

    def ensemble(self, n: int, steps: int, controller: Any = None, **options: Any) -> None:
        """Run n robots over some steps; none may diverge."""
        controller, trajectory = controller or self.computed, self.trajectory(steps * DT)
        loop = {"spread": self.spread, "dt": DT, "threads": 1, **options}
        found = self.of.ensemble(self.robot, controller, trajectory, n=n, **loop)
        if np.any(found.diverged):
            raise ArithmeticError(f"{np.sum(found.diverged)} robots diverged")

    def many(self, controller: Any = None, **options: Any) -> float:
        """Return the seconds of a robot-step; of fewer steps where this version needs too long for all."""
        n, steps = (QUICK_ROBOTS, QUICK_STEPS) if self.quick else (ROBOTS, STEPS)

        def run(steps: int) -> None:
            self.ensemble(n, steps, controller, **options)

        run(SHORT)  # which compiles
        tried = SHORT
        while tried < steps and processor_seconds(partial(run, tried)) <= LONGEST:
            tried = min(10 * tried, steps)
        return self.timed(partial(run, tried)) / (n * (tried + 1))

    def few(self, n: int) -> float:
        """Return the seconds of an ensemble of n robots."""
        return self.timed(lambda: self.ensemble(n, QUICK_STEPS if self.quick else STEPS))

    def rollout(self, engine: str, controller: Any = None, robot: Any = None, **options: Any) -> float:
        """Return the seconds of a rollout."""
        names = [name for name in ENGINES[engine] if hasattr(self.of, name)]
        if not names:
            raise Lacking(f"it has no engine {engine}")
        trajectory = options.pop("trajectory", None) or self.trajectory((SAMPLES - 1) * FINE)
        parts = robot or self.robot, controller or self.computed, trajectory
        given = {"dt": FINE, "engine": getattr(self.of, names[0]), **options}
        return self.timed(lambda: self.of.simulate(*parts, **given))

    def pd(self) -> Any:
        """Return PD."""
        return self.of.PD(PD_GAINS, PD_GAINS)

    def on_wheels(self, ground: Any) -> float:
        """Return the seconds of a rollout of a differential drive, a tenth as long."""
        wheel = {"mass": 1.0, "spin_inertia": 0.01, "yaw_inertia": 0.006}
        table = self.of.WheelTable.differential(0.5, 0.1, supports=[(-0.3, 0.0)], **wheel)
        robot = self.of.WheeledRobot(self.of.MobileRobot(30.0, 1.3, com=(0.1, 0.05, 0.2)), table, ground)
        trajectory = self.trajectory((SAMPLES - 1) // 10 * FINE)
        return self.rollout(
            "COMPILED", self.of.law(turning), robot, trajectory=trajectory, limit=1e6, substeps=4
        )

    def arm(self) -> float:
        """Return the seconds of a rollout of a UR5 on its base."""
        robot = self.of.MobileRobot.box().mount("ur5")
        duration = (SAMPLES - 1) // 2 * FINE
        joints = self.of.Hold(robot.rest[3:], duration)
        trajectory = self.of.WholeBody(robot, self.trajectory(duration), joints)
        return self.rollout("COMPILED", self.of.ComputedTorque(robot, 9, 6), robot, trajectory=trajectory)

    def raw(self) -> float:
        """Return the seconds of a raw Pinocchio loop that does the same as the rollout."""
        return self.timed(raw_pinocchio.rollout(Task(FINE, (SAMPLES - 1) * FINE)))

    def timed(self, run: Callable[[], Any]) -> float:
        """Return the median time of a run, after a first one [s]."""
        run()
        return median_time(lambda: processor_seconds(run), self.least)


def turning(t: float, q: Any, v: Any, reference: Any) -> Any:
    """Return torques of a left and a right side."""
    return np.array([0.6, 0.7]) + 0.0 * v[:2]


def branching(t: float, q: Any, v: Any, reference: Any) -> Any:
    """Return PD by a law that cannot be traced."""
    gains = PD_GAINS if q[0] < 1e9 else 0.0
    return gains * (reference.q - q) + gains * (reference.v - v)


LOOPS: dict[str, Callable[[Work], float]] = {
    "computed torque": lambda w: w.many(),
    "saturation": lambda w: w.many(w.of.InputSaturation(w.computed, [50, 50, 10])),
    "viscous and sinusoidal force": lambda w: w.many(
        forces=[w.of.ViscousFriction([3, 3, 1]), w.of.SinusoidalForce([1, 2, 0.1], 0.5)]
    ),
    "delay of 3 samples": lambda w: w.many(w.of.MeasurementDelay(w.computed, 3)),
    "rolling resistance": lambda w: w.many(forces=[w.of.RollingResistance([5, 5, 1])]),
    "rk4": lambda w: w.many(integrator=w.of.rk4),
    "a user's PID": lambda w: w.many(PID()),
    "a user's sliding mode": lambda w: w.many(SlidingMode()),
    "noise force": lambda w: w.many(forces=[w.of.NoiseForce([1, 1, 0.1], 2.0, 5)]),
    "PID": lambda w: w.many(w.of.PID(w.robot)),
    "adaptive": lambda w: w.many(w.of.Adaptive(w.robot)),
    "sliding mode": lambda w: w.many(w.of.SlidingMode(w.robot)),
    "super-twisting": lambda w: w.many(w.of.SuperTwisting(w.robot)),
    "ADRC": lambda w: w.many(w.of.ADRC(w.robot)),
    "disturbance observer": lambda w: w.many(w.of.DisturbanceObserver(w.computed, gain=GAIN)),
    "LQR": lambda w: w.many(w.of.LQR(w.robot)),
    "noisy measurement": lambda w: w.many(w.of.MeasurementNoise(w.computed, 1e-3, 1e-3, 3)),
}
"""Rows of many robots: seconds of a robot-step."""

RUNS: dict[str, Callable[[Work], float]] = {
    "ensemble, n = 1": lambda w: w.few(1),
    "ensemble, n = 16": lambda w: w.few(16),
    "ensemble, n = 100": lambda w: w.few(100),
    "simulate, compiled": lambda w: w.rollout("COMPILED"),
    "simulate, compiled, noise": lambda w: w.rollout(
        "COMPILED", w.of.MeasurementNoise(w.pd(), 1e-3, 1e-3, 3)
    ),
    "simulate, compiled, rk4": lambda w: w.rollout("COMPILED", integrator=w.of.rk4),
    "simulate, compiled, UR5": lambda w: w.arm(),
    "simulate, compiled, rolling": lambda w: w.on_wheels(w.of.Rolling()),
    "simulate, compiled, sliding": lambda w: w.on_wheels(w.of.Coulomb()),
    "simulate, Python": lambda w: w.rollout("PYTHON"),
    "simulate, Python, PD": lambda w: w.rollout("PYTHON", w.pd()),
    "simulate, Python, a law that cannot be traced": lambda w: w.rollout("PYTHON", w.of.law(branching)),
    "raw Pinocchio loop": lambda w: w.raw(),
}
"""Rows of one run: its seconds."""


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="few robots, few steps")
    parser.add_argument("--least", type=float, default=0.5, help="seconds for which a row is repeated")
    parser.add_argument("rows", nargs="+", choices=[*LOOPS, *RUNS], metavar="ROW")
    chosen = parser.parse_args(arguments)
    warnings.simplefilter("ignore")  # an older version says why it is slow
    work = Work(chosen.quick, chosen.least)
    print("\n" + json.dumps({row: measured(work, row) for row in chosen.rows}))
    return 0


def measured(work: Work, row: str) -> float | str:
    """Return the seconds of a row, or the word on why there are none."""
    try:
        return (LOOPS | RUNS)[row](work)
    except Lacking as lack:
        return str(lack)
    except Exception as error:  # whatever an older version raises: the other rows go on
        return f"FAILED: {type(error).__name__}: {error}"


if __name__ == "__main__":
    sys.exit(main())
