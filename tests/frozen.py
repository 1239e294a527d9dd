"""The numbers and tables of the library, frozen.

`python -m tests.frozen` writes tests/data/frozen.json. A run by COMPILED has the same bits on every
processor, so a digest is kept of it; of laws that call LAPACK, and of runs in Python, some samples are.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

import pinmobile as pm
from pinmobile.controllers import (
    ADRC,
    PID,
    Adaptive,
    Kanayama,
    SlidingMode,
    SuperTwisting,
    TorqueToVoltage,
    VelocityCommand,
    WheelSpeed,
)

FILE = Path(__file__).parent / "data" / "frozen.json"
COMPILED = pm.Engine.COMPILED
PYTHON = pm.Engine.PYTHON
BODY = pm.MobileRobot(30.0, 1.3, com=(0.1, 0.05))
WRONG = pm.MobileRobot(25.0, 1.0)


class Rounded:
    """A trajectory whose numbers no processor changes: NumPy's sines differ in their last bit."""

    def __init__(self, trajectory: Any) -> None:
        self.trajectory, self.duration = trajectory, trajectory.duration

    def __call__(self, t: Any) -> Any:
        found = self.trajectory(t)
        return type(found)(*(np.round(x, 9) for x in found))


CIRCLE: Any = Rounded(pm.Tangent(pm.Circle(2.0, 0.5, 6.0)))
WHEEL: dict[str, Any] = {"mass": 1.0, "spin_inertia": 0.01, "yaw_inertia": 0.006}
MOTOR = pm.Motor(resistance=1.2, torque_constant=0.05, voltage=24.0, gear=10.0, coulomb=0.02)


def turning(t: Any, q: Any, v: Any, reference: Any) -> Any:
    """Return torques of a left and a right side."""
    return np.array([0.6, 0.7]) + 0.0 * v[:2]


def own(t: Any, q: Any, v: Any, reference: Any) -> Any:
    """Return a user's own law."""
    return 40.0 * np.tanh(reference.q - q) + 30.0 * (reference.v - v)


class Leaky:
    """A user's controller with memory."""

    def initial_state(self, context: Any) -> Any:
        return {"sum": np.zeros(3), "dt": context.dt, "difference": context.difference}

    def __call__(self, t: Any, q: Any, v: Any, reference: Any, state: Any) -> Any:
        error = state["difference"](q, reference.q)
        total = 0.99 * state["sum"] + state["dt"] * error
        return 90.0 * error + 30.0 * total + 90.0 * (reference.v - v), {**state, "sum": total}


def branching(t: Any, q: Any, v: Any, reference: Any) -> Any:
    """Return what cannot be compiled."""
    error = reference.q - q
    return (120.0 if error[0] > 0 else 100.0) * error + 110.0 * (reference.v - v)


def table(kind: str, **more: Any) -> Any:
    """Return a table of wheels of this kind."""
    sides = (0.5, 0.1) if kind == "differential" else (0.5, 0.4, 0.1)
    return getattr(pm.WheelTable, kind)(*sides, **WHEEL, **more)


def loops() -> Iterator[tuple[str, tuple[Any, ...], dict[str, Any]]]:
    """Yield name, parts and options of closed loops: each part, each plant."""
    pd = pm.PD((120, 110, 5), (120, 110, 5))
    paths = {
        "via": pm.CubicVia((0, 0), (2, 2), (0, 4), 3.0, 6.0),
        "lissajous": pm.Lissajous(2.0, 1.0, 0.5, 1.0, 6.0),
        "line": pm.Line((0.5, 1.0), (3.0, -1.0), 6.0),
        "spline": pm.Spline([(0, 0), (1, 0.5), (2, 0.2), (3, 1.0)], [0, 2, 4, 6]),
    }
    for name, path in paths.items():
        yield name, (BODY, pm.ComputedTorque(WRONG, (4, 5, 6), 4), Rounded(pm.FixedHeading(path, 0.3))), {}
    controllers = {
        "PD": pd,
        "PD, matrix": pm.PD([[90, 5, 0], [3, 80, 1], [0, -1, 5]], 40.0),
        "computed torque": pm.ComputedTorque(BODY),
        "PDGravity": pm.PDGravity(BODY, (120, 110, 5), 30.0),
        "PID": PID(WRONG),
        "Decoupled": pm.controllers.Decoupled(WRONG),
        "sliding": SlidingMode(WRONG),
        "super-twisting": SuperTwisting(WRONG),
        "adaptive": Adaptive(WRONG, friction=True),
        "ADRC": ADRC(WRONG),
        "observer": pm.DisturbanceObserver(pm.ComputedTorque(WRONG)),
        "law": pm.law(own),
        "leaky": Leaky(),
        "saturated": pm.InputSaturation(pd, (20, 15, 2)),
        "delayed": pm.MeasurementDelay(pd, 2),
        "noisy": pm.MeasurementNoise(pd, 1e-3, 2e-3, seed=3),
        "all": pm.InputSaturation(
            pm.MeasurementDelay(pm.MeasurementNoise(PID(WRONG), 1e-3, 1e-3, seed=1), 1), (40, 30, 5)
        ),
    }
    for name, controller in controllers.items():
        yield name, (BODY, controller, CIRCLE), {}
    forces = {
        "constant": pm.ConstantForce((3, -2, 0.1), 1.0, 3.0),
        "sine": pm.forces.SinusoidalForce((2, 1, 0.1), 0.5, 0.3),
        "noise": pm.forces.NoiseForce((1, 2, 0.1), 2.0, seed=5),
        "viscous": pm.ViscousFriction((5, 9, 0.4)),
        "resistance": pm.RollingResistance((2, 3, 0.3), 0.1),
        "joints": pm.JointFriction(2.0, 1.0, 0.05),
        "payload": pm.forces.PayloadForce(6.0, (0.2, 0.1), 1.0, 0.1),
    }
    for name, force in forces.items():
        yield name, (BODY, pd, CIRCLE), {"forces": (force,), "integrator": pm.rk4, "substeps": 2}
    yield "all forces", (BODY, pd, CIRCLE), {"forces": tuple(forces.values())}
    options = {"integrator": pm.integrators.semi_implicit_euler, "substeps": 3}
    yield "semi-implicit", (BODY, pd, CIRCLE), options
    push: dict[str, Any] = {"limit": 1e6}
    held = pm.law(turning)
    for ground in (pm.Rolling(), pm.Coulomb()):
        kind = type(ground).__name__
        differential = table("differential", supports=[(-0.3, 0.0)])
        tall = pm.MobileRobot(30.0, 1.3, com=(0.05, 0.02, 0.2))
        yield f"differential {kind}", (pm.WheeledRobot(tall, differential, ground), held, CIRCLE), push
        mecanum = pm.WheeledRobot(tall, table("mecanum"), ground)
        yield f"mecanum {kind}", (mecanum, pm.ControlAllocation(pd, mecanum), CIRCLE), push
    skid = pm.WheeledRobot(BODY, table("skid_steer"), pm.Coulomb())
    yield "skid-steer", (skid, held, CIRCLE), push
    drive = pm.WheeledRobot(BODY, table("differential"))
    unicycle = pm.UnicycleTracking()
    yield "backstepping", (drive, pm.Backstepping(unicycle, drive), CIRCLE), {}
    yield "wheel speed", (drive, WheelSpeed(Kanayama(), drive, 0.5, 0.1), CIRCLE), {}
    electric = pm.WheeledRobot(BODY, table("differential", motor=MOTOR))
    by_torque = pm.Backstepping(unicycle, electric)
    yield "volts", (electric.by_voltage(), TorqueToVoltage(by_torque, electric), CIRCLE), {}
    commanded = pm.VelocityRobot([0.26, 0.25, 0.03, 1.1, 0.2, 1.2], accelerations=(2.0, 4.0))
    yield "commanded", (commanded, VelocityCommand(unicycle, commanded), CIRCLE), {}
    bare = pm.MobileRobot.box().mount("ur5")
    arm = bare.attach(pm.PayloadBody(2.0))
    base = pm.Tangent(pm.Circle(3.0, 0.1, 2.0))
    motion: Any = Rounded(pm.WholeBody(arm, base, pm.Hold(arm.rest[3:], 2.0)))
    yield "ur5", (arm, pm.ComputedTorque(bare, 9, 6), motion), {}
    yield "ur5, base alone", (arm, pm.law(_of_base), Rounded(base)), {"limit": 1e6}


def _of_base(t: Any, q: Any, v: Any, reference: Any) -> Any:
    force = 90.0 * (reference.q - q[:3]) + 90.0 * (reference.v - v[:3])
    return np.concatenate([force, -0.5 * v[3:]])


def by_lapack() -> Iterator[tuple[str, tuple[Any, ...], dict[str, Any]]]:
    """Yield loops whose law is designed by LAPACK."""
    yield "LQR", (BODY, pm.LQR(WRONG), CIRCLE), {}
    drive = pm.WheeledRobot(BODY, table("differential"))
    yield "LQR on wheels", (drive, pm.LQR(drive), CIRCLE), {}


def in_python() -> Iterator[tuple[str, tuple[Any, ...], dict[str, Any]]]:
    """Yield loops that run in Python, of which some cannot be compiled."""
    yield "branching", (BODY, pm.law(branching), CIRCLE), {}
    for name, parts, options in loops():
        if name in ("PD", "computed torque", "all", "all forces", "differential Rolling", "volts", "ur5"):
            yield name, parts, options


SPREADS: dict[str, dict[str, Any]] = {
    "PD": {"mass": pm.Uniform(25, 35), "com.x": pm.Normal(0.1, 0.02), "start.x": pm.Normal(0, 0.05)},
    "computed torque": {"yaw_inertia": pm.Uniform(1, 2), "start.psi": pm.Uniform(-0.1, 0.1)},
    "all": {"mass": pm.Uniform(25, 35)},
    "noise": {"mass": pm.Uniform(25, 35)},
    "differential Rolling": {"mass": pm.Uniform(25, 35), "start.x": pm.Uniform(-0.1, 0.1)},
    "differential Coulomb": {"mass": pm.Uniform(25, 35)},
    "ur5": {"start.y": pm.Uniform(-0.01, 0.01)},
}


def digest(*arrays: Any) -> str:
    """Return the digest of arrays."""
    found = hashlib.sha256()
    for array in arrays:
        found.update(np.ascontiguousarray(array).tobytes())
    return found.hexdigest()[:16]


def some(run: Any) -> list[float]:
    """Return some numbers of a run."""
    rows = [1, len(run.t) // 2, len(run.t) - 1]
    return [float(x) for part in (run.q, run.v, run.u, run.a) for k in rows for x in part[k]]


def frozen() -> dict[str, Any]:
    """Return all that is frozen."""
    found: dict[str, Any] = {"compiled": {}, "lapack": {}, "python": {}, "ensembles": {}, "tables": {}}
    for name, parts, options in loops():
        run = pm.simulate(*parts, dt=0.02, engine=COMPILED, **options)
        signals = [run.signals[one].values for one in sorted(run.signals)]
        found["compiled"][name] = digest(run.q, run.v, run.u, run.a, *signals)
        if name in ("PD", "all", "differential Coulomb", "ur5"):
            found["tables"][name] = str(run)
        if name in SPREADS:
            many = pm.ensemble(*parts, dt=0.02, n=5, seed=3, spread=SPREADS[name], engine=COMPILED, **options)
            records = many.max_error, many.rms_error, many.max_distance, many.max_input
            kept = np.array([one.worst != "ever" for one in many.scenario.channels])  # events came later
            metrics = kept[len(kept) - len(many.scenario.recorded_metrics) :]
            sizes = many.counts[:, kept], *many.draws.values(), many.worst_metric[:, metrics]
            found["ensembles"][name] = digest(*records, *sizes)
            found["tables"][f"ensemble {name}"] = str(many)
    for kind, given in (("lapack", by_lapack), ("python", in_python)):
        for name, parts, options in given():
            engine = COMPILED if kind == "lapack" else PYTHON
            found[kind][name] = some(pm.simulate(*parts, dt=0.02, engine=engine, **options))
    return found


if __name__ == "__main__":
    FILE.write_text(json.dumps(frozen(), indent=0) + "\n")
