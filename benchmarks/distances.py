"""Clearance: the processor's time for a posture, beside the same distances by Pinocchio and by MuJoCo.

Usage: python benchmarks/distances.py [--quick] [--rounds N] [--only WORD ...]

Random postures of a UR5, whose links are meshes, and of a panda of cylinders and spheres, on a box: all pairs
that `pinmobile.clearance` counts, placements included for the library, and for Pinocchio; MuJoCo is given
them. Pinocchio takes meshes as their hulls; the library looks at the meshes themselves where they may be the
nearest. Whose distances of what does not overlap differ by more than 1e-6 m is not timed.
"""

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin
from measuring import Row, about, console, interleaved, picked, say, selecting, table
from wheels import timed

import pinmobile as pm

POSTURES, QUICK = 500, 20
SAME = 1e-6  # [m]
ROBOTS = {"UR5, meshes": "ur5", "panda, cylinders and spheres": "panda_collision"}


@dataclass(frozen=True)
class One:
    """Who takes part: `prepare(robot, q)` returns what gives the least distance of each posture."""

    name: str
    prepare: Callable[[Any, Any], Callable[[], Any] | None]


def robot_of(arm: str) -> pm.MobileRobot:
    return pm.MobileRobot.box(100, (0.8, 0.6, 0.3)).mount(arm, (0.1, -0.05, 0.3, 0.4))


def of_pinmobile(robot: pm.MobileRobot, q: Any) -> Callable[[], Any]:
    return lambda: pm.clearance(robot, q).distance


def counted(robot: pm.MobileRobot) -> list[tuple[int, int]]:
    """Return the pairs of shapes that count; the ground comes after all shapes."""
    links = [shape.link for shape in robot.solids.shapes] + ["ground"]
    pairs = pm.clearance(robot, robot.rest).pairs
    return [
        (i, j)
        for a, b in pairs
        for i, own in enumerate(links)
        for j, other in enumerate(links)
        if (own, other) == (a, b)
    ]


def of_pinocchio(robot: pm.MobileRobot, q: Any) -> Callable[[], Any]:
    """Return a loop over Pinocchio's computeDistances, hulls on the joints of the model."""
    import coal

    model, shapes = robot.model, pin.GeometryModel()
    for k, each in enumerate(robot.solids.shapes):
        shapes.addGeometryObject(pin.GeometryObject(f"{k}", each.part + 3, each.placement, each.geometry))
    plane = coal.Halfspace(np.array([0.0, 0.0, 1.0]), 0.0)
    shapes.addGeometryObject(pin.GeometryObject("ground", 0, pin.SE3.Identity(), plane))
    for pair in counted(robot):
        shapes.addCollisionPair(pin.CollisionPair(*pair))
    data, there, rows = model.createData(), shapes.createData(), q[:, [1, 0, *range(2, q.shape[1])]]

    def run() -> Any:
        found = np.empty(len(rows))
        for k, row in enumerate(rows):
            pin.computeDistances(model, data, shapes, there, row)
            found[k] = min(result.min_distance for result in there.distanceResults)
        return found

    return run


def of_mujoco(robot: pm.MobileRobot, q: Any) -> Callable[[], Any] | None:
    """Return a loop over MuJoCo's mj_geomDistance; None where a shape is a mesh."""
    import mujoco

    if any(shape.mesh is not None for shape in robot.solids.shapes):
        return None
    geoms = []
    for shape in robot.solids.shapes:
        own, kind = shape.geometry, type(shape.geometry).__name__.lower()
        size = own.halfSide if kind == "box" else [own.radius, getattr(own, "halfLength", 0.0)]
        geoms.append(f'<geom type="{kind}" size="{" ".join(map(str, size))}"/>')
    text = f'<mujoco><worldbody>{"".join(geoms)}<geom type="plane" size="9 9 1"/></worldbody></mujoco>'
    model = mujoco.MjModel.from_xml_string(text)
    model.opt.ccd_tolerance, model.opt.ccd_iterations = 1e-10, 1000
    data, pairs = mujoco.MjData(model), counted(robot)
    mujoco.mj_kinematics(model, data)
    placements = robot.solid_placements(q)

    def run() -> Any:
        found = np.empty(len(placements))
        for k, row in enumerate(placements):
            data.geom_xpos[:-1], data.geom_xmat[:-1] = row[:, :3, 3], row[:, :3, :3].reshape(-1, 9)
            found[k] = min(mujoco.mj_geomDistance(model, data, i, j, 9.0, None) for i, j in pairs)
        return found

    return run


EVERYONE = (
    One("clearance", of_pinmobile),
    One("Pinocchio's computeDistances of hulls", of_pinocchio),
    One("MuJoCo's mj_geomDistance, placements given", of_mujoco),
)


def main(arguments: Sequence[str] | None = None) -> int:
    chosen = selecting(__doc__.splitlines()[0]).parse_args(arguments)
    rounds, count = chosen.rounds or (1 if chosen.quick else 5), QUICK if chosen.quick else POSTURES
    out, sound = console(), True
    out.print(about(), f"medians over {rounds} interleaved rounds of processor seconds", sep="; ")
    for title, arm in ROBOTS.items():
        robot = robot_of(arm)
        q = robot.random_configuration(np.random.default_rng(0), (count,))
        q[:, :3] = 0.0
        expected, runs, words = of_pinmobile(robot, q)(), {}, []
        exact = all(shape.mesh is None for shape in robot.solids.shapes)
        for one in picked(EVERYONE, chosen.only):
            try:
                run = one.prepare(robot, q)
            except ImportError as error:
                words.append(f"{one.name}: not installed, {error}")
                continue
            if run is None:
                words.append(f"{one.name}: not of meshes")
                continue
            apart = (expected - run())[expected > 0]  # of hulls that are nearer than meshes it is above zero
            if not (np.abs(apart) if exact else -apart).max(initial=0.0) <= SAME:
                words.append(f"{one.name}: WRONG, not timed: off by {np.abs(apart).max():.1e} m")
                sound = False
                continue
            runs[one.name] = timed(run)
        taken = interleaved(runs, rounds)
        shown = table(f"\n{title}: {len(counted(robot))} pairs of shapes", "contestant", "", "us/posture")
        for name, times in sorted(taken.items(), key=lambda pair: Row("", times=pair[1]).median):
            shown.add_row(name, "", f"{Row('', times=times).median / count * 1e6:.0f}")
        out.print(shown)
        say(out, words)
    return 0 if sound else 1


if __name__ == "__main__":
    sys.exit(main())
