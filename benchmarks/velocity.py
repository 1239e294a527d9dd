"""Ten published robots that take speeds: simulated, excited, identified again; what is inside the intervals.

Usage: python benchmarks/velocity.py [--quick] [--rounds N] [--only WORD ...]

Logs of 60 s of random steps, of encoders (noise 5 mm/s, 10 mrad/s) and of poses (1 mm, 1 mrad). With --quick,
two robots; the delay is not known.
Seconds are those of the processor.
"""

import sys
from collections.abc import Sequence
from time import process_time

import numpy as np
from measuring import selecting

import pinmobile as pm
from pinmobile.identification import VELOCITY_ROBOTS

DT, SECONDS = 0.05, 60.0
NOISE = {"encoders": (5e-3, 10e-3), "poses": (1e-3, 1e-3, 1e-3)}


def logged(robot: pm.VelocityRobot, seed: int, kind: str) -> pm.Log:
    """Return what is logged of a robot under random steps."""
    still = pm.FixedHeading(pm.Hold((0, 0), SECONDS), 0.0)
    substeps = int(np.ceil(DT / min(robot.time_constants) / 0.2))
    run = pm.simulate(
        robot,
        pm.controllers.RandomSteps(seed=seed),
        still,
        dt=DT,
        substeps=substeps,
        engine=pm.Engine.COMPILED,
    )
    rng = np.random.default_rng([seed, 7])
    true = run.q if kind == "poses" else robot.independent(run.q, run.v)
    seen = true + NOISE[kind] * rng.normal(size=true.shape)
    if kind == "poses":
        return pm.Log(run.t, seen, run.u)
    return pm.Log(run.t, None, run.u, twist=np.stack([seen[:, 0], 0 * seen[:, 0], seen[:, 1]], axis=-1))


def main(arguments: Sequence[str] | None = None) -> int:
    """Print, for each kind of log and robot, what is inside its interval and what may as well be zero."""
    chosen = selecting(__doc__.splitlines()[0]).parse_args(arguments)
    names = list(VELOCITY_ROBOTS)[: 2 if chosen.quick else None]
    for kind in NOISE:
        inside, worst, spent = 0, 0.0, 0.0
        for seed, name in enumerate(names):
            robot, log = VELOCITY_ROBOTS[name], logged(VELOCITY_ROBOTS[name], seed, kind)
            begin = process_time()
            found = pm.identify_velocity(log)
            spent += process_time() - begin
            bounds, errors = list(found.interval().values()), list(found.standard_errors.values())
            here = sum(low <= x <= high for x, (low, high) in zip(robot.theta, bounds[:6], strict=True))
            far = float(np.abs((found.theta - robot.theta) / errors[:6]).max())
            inside, worst = inside + here, max(worst, far)
            zero = ", ".join(found.insignificant) or "none"
            print(f"{kind:9} {name:19} {here} of 6 inside, {far:.1f} errors off; may be zero: {zero}")
        print(f"{kind}: {inside} of {6 * len(names)} inside 95 %, at most {worst:.1f} off, {spent:.1f} s")
    return 0


if __name__ == "__main__":
    sys.exit(main())
