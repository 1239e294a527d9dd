"""Whether two versions of pinmobile give the same, bit for bit.

Usage: python benchmarks/same.py BEFORE [AFTER]

BEFORE and AFTER are folders with a version each, such as `git worktree add` makes; AFTER is this one by
default. Both run the same rollouts, ensembles, sweeps, tables, figures and pages, and the notebooks; of what
each gives the digest is compared.
"""

import argparse
import contextlib
import hashlib
import io
import itertools
import json
import os
import re
import runpy
import subprocess
import sys
import tempfile
import uuid
import warnings
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
NOTEBOOKS = sorted(path.stem for path in (ROOT / "notebooks").glob("[0-9]*.py"))
STOPPED = " stopped"
TIMED = re.compile(r"\d[\d.,]* (s|ms|min|MB|million)\b|0x[0-9a-f]+")  # what differs from run to run


def digest(*values: Any) -> str:
    """Return the digest of arrays, texts and bytes."""
    import numpy as np

    found = hashlib.sha256()
    for value in values:
        if isinstance(value, str):
            value = value.encode()
        found.update(value if isinstance(value, bytes) else np.ascontiguousarray(value).tobytes())
    return found.hexdigest()[:16]


def _turning(t: Any, q: Any, v: Any, reference: Any) -> Any:
    """Return torques of a left and a right side that turn alike but for their sizes."""
    import numpy as np

    return np.array([0.3, 0.25]) * (1 + 0 * v[..., :2])


def loops() -> Iterator[tuple[str, Any]]:
    """Yield names and parts of closed loops: the lecture's six, and others."""
    import pinmobile as pm

    paths = {
        "circle": pm.Circle(3.0, 0.1, 60.0),
        "lissajous": pm.Lissajous(3.0, 3.0, 0.2, 0.1, 60.0),
        "via": pm.CubicVia((0, 0), (2, 2), (0, 4), 30.0, 60.0),
    }
    body = pm.MobileRobot(30.0, 1.3, com=(0.1, 0.05))
    for name, path in paths.items():
        for heading in (pm.Tangent(path), pm.trajectories.LectureHeading(path)):
            kind = f"{name} {type(heading).__name__}"
            yield f"{kind} PD", (body, pm.PD((120, 120, 0.4), (120, 120, 0.4)), heading, {})
            yield f"{kind} computed torque", (body, pm.ComputedTorque(body, 4, 4), heading, {})
    believed = pm.MobileRobot(25.0, 1.0)
    noisy = pm.MeasurementDelay(pm.MeasurementNoise(pm.ComputedTorque(believed, 4, 4), 1e-3, 1e-3, seed=3), 2)
    acting = {
        "forces": (
            pm.ViscousFriction((3, 4, 0.5)),
            pm.forces.SinusoidalForce((2, 1, 0.1), 0.5),
            pm.forces.NoiseForce((1, 1, 0.1), 2.0, seed=5),
        ),
        "integrator": pm.rk4,
        "substeps": 2,
    }
    wheel: dict[str, Any] = {"mass": 1.0, "spin_inertia": 0.01, "yaw_inertia": 0.006}
    tables = {
        "differential": pm.WheelTable.differential(0.5, 0.1, supports=[(0.3, 0.0)], **wheel),
        "skid-steer": pm.WheelTable.skid_steer(0.5, 0.4, 0.1, **wheel),
        "mecanum": pm.WheelTable.mecanum(0.5, 0.4, 0.1, **wheel),
    }
    for name, table in tables.items():
        drive = pm.WheeledRobot(body, table)
        if name == "mecanum":
            yield name, (drive, pm.ComputedTorque(drive, 4, 4), pm.Tangent(paths["circle"]), {})
        else:
            yield name, (drive, pm.law(_turning), pm.Tangent(paths["circle"]), {"limit": 1e6})
    yield "all at once", (body, pm.InputSaturation(noisy, (80, 80, 20)), pm.Tangent(paths["circle"]), acting)
    bare = pm.MobileRobot.box().mount("ur5")
    arm = bare.attach(pm.PayloadBody(2.0))
    trajectory = pm.WholeBody(arm, pm.Tangent(pm.Circle(3.0, 0.1, 3.0)), pm.Hold(arm.rest[3:], 3.0))
    yield "ur5", (arm, pm.ComputedTorque(arm, 9, 6), trajectory, {})
    yield (
        "ur5 believed without its load",
        (arm, pm.ComputedTorque(bare, 4, 4), trajectory, {"integrator": pm.rk4, "substeps": 2}),
    )


def rollouts() -> Iterator[tuple[str, str]]:
    """Yield digests of rollouts by Python and compiled."""
    import pinmobile as pm

    for name, (robot, controller, trajectory, options) in loops():
        for engine in (pm.Engine.PYTHON, pm.Engine.COMPILED):
            run = pm.simulate(robot, controller, trajectory, dt=0.05, engine=engine, **options)
            yield f"rollout {name} {engine!r}", digest(run.t, run.q, run.v, run.a, run.u, str(run))


def ensembles() -> Iterator[tuple[str, str]]:
    """Yield digests of ensembles by all engines, and of a sweep."""
    import pinmobile as pm

    for name, (robot, controller, trajectory, options) in loops():
        spread: dict[str, Any] = {"mass": pm.Uniform(20, 40), "start.x": pm.Normal(0, 0.05)}
        if "ur5" in name:
            spread["loads.0.mass"] = pm.Uniform(0, 3)
        for engine in (pm.Engine.COMPILED, pm.Engine.COMPILED):
            run = pm.ensemble(
                robot, controller, trajectory, n=20, spread=spread, dt=0.1, engine=engine, **options
            )
            columns = (run.max_error, run.rms_error, run.max_distance, run.max_input, run.counts[:, :2])
            yield f"ensemble {name} {engine!r}", digest(*columns, *run.draws.values())
    robot, controller, trajectory, options = next(value for _, value in loops())

    parts = {"robot": robot, "controller": controller, "trajectory": trajectory}
    one = pm.Scenario(**parts, n=50, spread={}, dt=0.1, **options)
    grid = {"spread.mass": {mass: pm.Normal(mass, 1) for mass in (25.0, 30.0)}}
    with tempfile.TemporaryDirectory() as folder:
        found = pm.sweep(one, Path(folder) / "store", grid=grid)
        each = [found.ensemble(**{"spread.mass": mass}) for mass in (25.0, 30.0)]
        numbers = (column for run in each for column in (run.max_error, run.rms_error, run.max_input))
        yield "sweep", digest(*numbers, found.table())


def tables() -> Iterator[tuple[str, str]]:
    """Yield digests of what is told in words."""
    import pinmobile as pm
    from pinmobile import derivation

    arm = pm.MobileRobot.box().mount("ur5")
    for name, robot in {"bare": pm.MobileRobot(30.0, 1.3, com=(0.1, 0.05)), "ur5": arm}.items():
        yield f"verify {name}", digest(str(pm.verify(robot)))
    yield "integrators", digest(str(pm.accuracy.integrator_report(pm.rk4)))
    for name, found in {
        "lecture": derivation.lecture(),
        "slide": derivation.derive(pm.dh.SLIDE_TABLE),
    }.items():
        yield f"derivation {name}", digest(str(found), repr(found))
    yield "urdf", digest(arm.to_urdf(), repr(arm))


def pictures() -> Iterator[tuple[str, str]]:
    """Yield digests of figures and pages."""
    import matplotlib

    import pinmobile as pm
    from pinmobile import plots
    from pinmobile.viewer import Viewer

    matplotlib.rcParams["svg.hashsalt"] = "same"
    chosen = ("circle Tangent PD", "all at once", "ur5")
    runs = {name: pm.simulate(*parts[:3], dt=0.1, **parts[3]) for name, parts in loops() if name in chosen}
    for name, run in runs.items():
        for draw in ("path", "states", "errors", "forces", "balance"):
            out = io.BytesIO()
            getattr(plots, draw)(run).savefig(out, format="svg", metadata={"Date": None})
            yield f"figure {draw} {name}", digest(out.getvalue())
        with Viewer(run.plant) as viewer:
            yield f"page {name}", digest(viewer.record(run).html())


def notebooks() -> Iterator[tuple[str, str]]:
    """Yield digests of what the notebooks print, times left out."""
    for name in NOTEBOOKS:
        out = io.StringIO()
        with contextlib.redirect_stdout(out):
            runpy.run_path(str(ROOT / "notebooks" / f"{name}.py"))
        yield f"notebook {name}", digest(TIMED.sub("", out.getvalue()))


WORK: Sequence[Callable[[], Iterator[tuple[str, str]]]] = (rollouts, ensembles, tables, pictures, notebooks)


def one() -> None:
    """Print all digests of the version that is imported."""
    warnings.simplefilter("ignore")
    numbers = itertools.count()
    uuid.uuid1 = lambda *given: uuid.UUID(int=next(numbers))  # meshcat's names of objects, in its pages
    found = {}
    for work in WORK:
        try:
            for name, value in work():
                found[name] = value
                print(name, file=sys.stderr, flush=True)
        except Exception as error:  # the others go on
            found[f"{work.__name__}{STOPPED}"] = f"{type(error).__name__}: {error}"
    print(json.dumps(found))


def digests(folder: Path) -> dict[str, str]:
    """Return the digests of the version in a folder."""
    environment = {
        **os.environ,
        "PYTHONPATH": str(folder / "src"),
        "MPLBACKEND": "agg",
        "PINMOBILE_CACHE": "",
    }
    done = subprocess.run(
        [sys.executable, __file__, "--one"], env=environment, stdout=subprocess.PIPE, text=True, check=True
    )
    found: dict[str, str] = json.loads(done.stdout.splitlines()[-1])
    return found


def main(arguments: Sequence[str] | None = None) -> int:
    """Compare two versions; return 1 where they differ."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("before", type=Path, nargs="?", help="a folder with the version before")
    parser.add_argument("after", type=Path, nargs="?", default=ROOT, help="that after; by default this one")
    parser.add_argument("--one", action="store_true", help=argparse.SUPPRESS)
    given = parser.parse_args(arguments)
    if given.one:
        one()
        return 0
    if given.before is None:
        parser.error("which folder has the version before?")
    before, after = digests(given.before), digests(given.after)
    names = dict.fromkeys([*before, *after])
    other = [name for name in names if before.get(name) != after.get(name) or name.endswith(STOPPED)]
    for name in other:
        print(f"differs: {name}: {before.get(name, 'missing')} before, {after.get(name, 'missing')} after")
    print(f"{len(names) - len(other)} of {len(names)} are the same, bit for bit")
    return 1 if other else 0


if __name__ == "__main__":
    sys.exit(main())
