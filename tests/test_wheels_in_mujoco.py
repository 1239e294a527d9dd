"""Real wheel bodies on a plane in MuJoCo: spheres, and wheels with rollers that are modelled one by one.

Contacts there are soft. Hard and with friction that does not creep (elliptic cone, impratio 100, solimp
0.999) they are near to rolling; a roller is an ellipsoid whose envelope with the others' is round: with
semi-axes a, a and L it has at its middle the curvature of the wheel of radius R, L^2 = a^2 + a (R - a) /
cos^2(gamma).

Of four wheels on rigid ground, loads depend on how many micrometres rollers stand out; here each such wheel
hangs on a spring, as those of `WheeledRobot` do, which the body's weight bends by a millimetre.
"""

from typing import Any

import mujoco
import numpy as np
import pinocchio as pin
import pytest

import pinmobile as pm
from pinmobile.arrays import Array
from pinmobile.wheels import Wheel, WheelFriction

pytestmark = [pytest.mark.once, pytest.mark.long]

OWN: dict[str, Any] = {
    "mass": 1.0,
    "spin_inertia": 0.006,
    "yaw_inertia": 0.004,
    "friction": WheelFriction(across=0.0, rolling=0.0),
}
BASE = pm.MobileRobot(30.0, 1.3, com=(0.03, 0.01, 0.2), size=(0.6, 0.5, 0.2))
ROLLERS, THIN, ROLLER_MASS = 16, 0.22, 0.002  # of a wheel; radius of a roller by that of its wheel; [kg]
STEP, PACE = 0.0005, 2  # [s] of MuJoCo, and how many of its steps one of ours has
SPRING = 5e4  # [N/m] of a wheel with rollers, beside three others
OPTIONS = f'<option timestep="{STEP}" cone="elliptic" impratio="100" integrator="implicitfast"/>'
HARD = 'solref="0.002 1" solimp="0.999 0.9999 0.001" friction="1 0.0001 0.0001"'


def numbers(x: Any) -> str:
    return " ".join(f"{each:.17g}" for each in np.ravel(x))


def inertial(body: pin.Inertia) -> str:
    I = body.inertia  # noqa: E741 (as it is called)
    full = [I[0, 0], I[1, 1], I[2, 2], I[0, 1], I[0, 2], I[1, 2]]
    return f'<inertial pos="{numbers(body.lever)}" mass="{body.mass}" fullinertia="{numbers(full)}"/>'


def turned(axis: str, angle: float) -> Array:
    return np.array(pin.utils.rotate(axis, angle))


def rolling(wheel: Wheel) -> str:
    """Return the bodies of the rollers of a wheel, along its axes: e, n and up."""
    a, R, gamma, found = THIN * wheel.radius, wheel.radius, wheel.roller or 0.0, ""
    length = np.sqrt(a**2 + a * (R - a) / np.cos(gamma) ** 2)
    for k in range(ROLLERS):
        turn = turned("y", 2 * np.pi * k / ROLLERS)
        at, axis = turn @ [0, 0, a - R], turn @ [np.cos(gamma), np.sin(gamma), 0]
        found += (
            f'<body pos="{numbers(at)}"><joint type="hinge" axis="{numbers(axis)}" armature="1e-6"/>'
            f'<geom type="ellipsoid" size="{numbers([a, a, length])}" zaxis="{numbers(axis)}" '
            f'mass="{ROLLER_MASS}" contype="0" conaffinity="1" {HARD}/></body>'
        )
    return found


def bodies(robot: pm.MobileRobot, table: pm.WheelTable) -> str:
    """Return the robot as MuJoCo's XML; a support is a ball without friction."""
    whole, wheels = pin.Inertia(robot.body.mass, robot.body.com, robot.body.inertia), ""
    for wheel in table.wheels:
        place = pin.SE3(turned("z", wheel.angle), np.array([*wheel.centre, wheel.radius]))
        I = np.diag([wheel.yaw_inertia, wheel.spin_inertia, wheel.yaw_inertia])  # noqa: E741
        whole -= place.act(pin.Inertia(wheel.mass, np.zeros(3), I))
        own, contact = pin.Inertia(wheel.mass, np.zeros(3), I), ""
        if wheel.roller is None:
            contact = (
                f'<geom type="sphere" size="{wheel.radius}" mass="0" contype="0" conaffinity="1" {HARD}/>'
            )
        else:
            contact = rolling(wheel)
            far, m = (1 - THIN) * wheel.radius, ROLLERS * ROLLER_MASS
            I = I - m * far**2 * np.diag([0.5, 1.0, 0.5])  # noqa: E741
            own = pin.Inertia(wheel.mass - m, np.zeros(3), I)
        spring = ""
        if len(table) + len(table.supports) > 3:
            damping = 2 * np.sqrt(SPRING * robot.mass / len(table))
            spring = f'<joint type="slide" axis="0 0 1" stiffness="{SPRING}" damping="{damping}"/>'
        wheels += (
            f'<body name="{wheel.name}" pos="{numbers(place.translation)}" euler="0 0 {wheel.angle:.17g}">'
            f'{spring}<joint name="{wheel.name}" type="hinge" axis="0 1 0"/>{inertial(own)}{contact}</body>'
        )
    for each in table.supports:
        wheels += (
            f'<geom type="sphere" size="0.05" pos="{each.x} {each.y} 0.05" mass="0" condim="1" contype="0" '
            f'conaffinity="1" {HARD}/>'
        )
    motors = "".join(f'<motor joint="{wheel.name}"/>' for wheel in table.wheels if wheel.motor)
    return (
        f'<mujoco><compiler angle="radian" inertiafromgeom="false"/>{OPTIONS}<worldbody>'
        f'<geom type="plane" size="20 20 1" condim="1" contype="1" conaffinity="1" {HARD}/>'
        f'<body name="base"><freejoint/>{inertial(whole)}{wheels}</body></worldbody>'
        f"<actuator>{motors}</actuator></mujoco>"
    )


def driven(table: pm.WheelTable, u: Array, T: float) -> tuple[Array, Array]:
    """Return x, y, psi at each ms, and the mean load of each wheel and support after half a second."""
    xml = bodies(BASE, table).replace('inertiafromgeom="false"', 'inertiafromgeom="auto"')
    model = mujoco.MjModel.from_xml_string(xml)
    data = mujoco.MjData(model)
    data.ctrl[:] = 0
    for _ in range(round(0.6 / STEP)):  # it settles
        mujoco.mj_step(model, data)
    data.qvel[:] = 0
    mujoco.mj_forward(model, data)
    start, path, count = data.qpos[:7].copy(), [], round(T / STEP)
    begun = round(0.5 / STEP)
    owners = [*table.names, *(f"support {k}" for k in range(len(table.supports)))]
    loads, force = np.zeros(len(owners)), np.zeros(6)
    data.ctrl[:] = u
    for step in range(count):
        mujoco.mj_step(model, data)
        w, x, y, z = data.qpos[3:7]
        path.append([*data.qpos[:2], np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))])
        if step < begun:
            continue
        for k in range(data.ncon):
            contact = data.contact[k]
            mujoco.mj_contactForce(model, data, k, force)
            body = model.geom_bodyid[max(contact.geom)]
            while body and model.body(body).name not in ("base", *table.names):
                body = model.body_parentid[body]
            name = model.body(body).name
            at = len(table) if name == "base" else owners.index(name)
            loads[at] += force[0] / (count - begun)
    found = np.array(path)[PACE - 1 :: PACE]
    found[:, :2] -= start[:2]
    found[:, 2] = np.unwrap(found[:, 2])
    return found, loads


def ours(table: pm.WheelTable, u: Array, T: float, ground: Any = None) -> Any:
    robot, own = pm.WheeledRobot(BASE, table, ground), pm.rk4 if ground is None else None
    controller, still = pm.law(lambda t, q, v, reference: u), pm.FixedHeading(pm.Hold([0, 0], T), 0.0)
    return pm.simulate(
        robot, controller, still, dt=0.001, q0=robot.rest, integrator=own, engine=pm.Engine.COMPILED
    )


def length(path: Array) -> float:
    return float(np.linalg.norm(np.diff(path[:, :2], axis=0), axis=1).sum())


def test_a_differential_drive_on_spheres_goes_where_rolling_goes() -> None:
    table = pm.WheelTable.differential(0.5, 0.1, supports=[(0.25, 0)], **OWN)
    u, T = np.array([0.9, 1.1]), 3.0
    path, loads = driven(table, u, T)
    run = ours(table, u, T)
    off = np.linalg.norm(path[-1, :2] - run.q[-1, :2])
    assert off < 0.005 * length(run.q)
    assert abs(path[-1, 2] - run.q[-1, 2]) < np.radians(0.5)
    np.testing.assert_allclose(loads, loads_of(table, u, T), rtol=0.01)


def loads_of(table: pm.WheelTable, u: Array, T: float) -> Array:
    """Return the mean load of each wheel and support after half a second, where wheels may slip."""
    found = ours(table, u, T, pm.Coulomb(mu=1.0)).signals["loads"].values
    return np.asarray(found[501:].mean(axis=0))


MADE = {
    "omni": pm.WheelTable.omni(0.25, 0.1, first=np.pi / 2, **OWN),
    "mecanum": pm.WheelTable.mecanum(0.5, 0.45, 0.1, **OWN),
}


@pytest.mark.parametrize("kind", MADE)
def test_wheels_with_rollers_go_sideways_as_they_roll_and_carry_as_much(kind: str) -> None:
    table, T = MADE[kind], 2.0
    robot = pm.WheeledRobot(BASE, table)
    u = robot.inverse_dynamics(robot.rest, np.zeros(robot.nv), [0.0, 0.5, 0.0])
    path, loads = driven(table, u, T)
    run = ours(table, u, T)
    assert abs(run.q[-1, 1]) > 0.8
    assert np.linalg.norm(path[-1, :2] - run.q[-1, :2]) < 0.02 * length(run.q)
    # Of some twenty rollers each takes the load from the one before. Where contacts give way, the one that
    # comes carries a little more than the one that goes: rollers at 45 degrees carry a millimetre off the
    # wheel's middle, of 450 between two, and no wheel more or less than half a percent. Loads at rest are
    # off by five.
    np.testing.assert_allclose(loads, loads_of(table, u, T), rtol=0.01)
