"""Plants that are no `MobileRobot`: all that the library does with them, by what they say of themselves."""

from functools import cache
from typing import Any

import coal
import numpy as np
import pinocchio as pin
import pytest

import pinmobile as pm
from pinmobile import plots
from pinmobile.arrays import Array
from pinmobile.integrators import constant_acceleration
from pinmobile.loop import Loop
from pinmobile.plant import Context, Coordinate, Input, Step
from pinmobile.viewer import Overlays, Viewer
from pinmobile.viewer.motion import configurations, figure, links
from tests.looping import looped
from tests.parts import Axle
from tests.refusals import refusals
from tests.users import Follower, TwoWheels

PATH = pm.Tangent(pm.Circle(2, 0.25, 20))
FORCES = (pm.ViscousFriction([2, 0, 0.1]), Axle(0.01))


@cache
def driven() -> pm.Rollout:
    return pm.simulate(TwoWheels(), Follower(), PATH, dt=0.02, forces=FORCES, integrator=pm.rk4)


def test_figures_have_its_names_and_units() -> None:
    labels = {
        draw.__name__: [axes.get_ylabel() for axes in draw(driven()).axes]
        for draw in (plots.states, plots.errors, plots.forces, plots.signals)
    }
    assert labels == {
        "states": ["$x$ [m]", "$y$ [m]", r"$\psi$ [rad]", "left wheel [rad]", "right wheel [rad]"],
        "errors": ["error in $x$ [m]", "error in $y$ [m]", r"error in $\psi$ [rad]"],
        "forces": ["left torque [N m]", "right torque [N m]"],
        "signals": ["error across [m]"],
    }
    (axes,) = plots.path({"two wheels": driven()}).axes
    travelled = next(line for line in axes.lines if line.get_label() == "travelled")
    np.testing.assert_array_equal(np.array(travelled.get_data()).T, driven().q[:, :2])


class Polar:
    """A point mass of 30 kg, q = (bearing, range, heading relative to the bearing)."""

    nq = nv = nu = 3

    def forward_dynamics(self, q: Array, v: Array, u: Array, f: Any = 0.0) -> Array:
        effects = np.array([2 * q[1] * v[0] * v[1], -q[1] * v[0] ** 2, 0.0])
        return np.asarray((u + f - 30.0 * effects) / np.array([30.0 * q[1] ** 2, 30.0, 1.0]))

    def integrate(self, q: Array, dq: Array) -> Array:
        return q + dq

    def difference(self, q0: Array, q1: Array) -> Array:
        return q1 - q0

    def pose(self, q: Array) -> Array:
        theta, r, phi = q[..., 0], q[..., 1], q[..., 2]
        return np.stack([r * np.cos(theta), r * np.sin(theta), theta + phi], axis=-1)


def test_the_distance_is_that_of_poses_whatever_the_coordinates() -> None:
    circle = pm.FixedHeading(pm.Circle(radius=0.5, rate=0.5, duration=4, centre=(0.0, 3.0)), 0.0)
    run = pm.simulate(Polar(), pm.PD((900, 100, 1), (300, 100, 1)), circle, dt=0.01)
    desired, actual = Polar().pose(run.reference.q), Polar().pose(run.q)
    expected = np.hypot(*(desired - actual)[:, :2].T)
    np.testing.assert_allclose(run.distance, expected, rtol=1e-12, atol=0)
    mixed = np.hypot(*run.error[:, :2].T).max()
    assert abs(mixed / expected.max() - 1) > 0.1
    assert 0.1 < expected.max() < 1
    assert f"at most {10 * np.ceil(100 * expected.max()):.0f} mm" in plots.path(run).axes[0].get_title()


class Drawn(TwoWheels):
    """Two wheels that are seen to turn: a body, and a wheel on each side."""

    def __init__(self) -> None:
        super().__init__()
        model = pin.GeometryModel()
        object.__setattr__(self, "visual_model", model)
        wheel = coal.Cylinder(0.1, 0.04)
        for name, shape in (("body", coal.Box(0.4, 0.3, 0.1)), ("left", wheel), ("right", wheel)):
            model.addGeometryObject(pin.GeometryObject(name, 0, pin.SE3.Identity(), shape))

    def drawing(self, q: Array) -> Any:
        body = pin.SE3(pin.utils.rotate("z", q[2]), np.array([q[0], q[1], 0.1]))
        lying = pin.utils.rotate("x", -np.pi / 2)
        wheels = (
            body * pin.SE3(pin.utils.rotate("y", angle) @ lying, np.array([0.0, side, 0.0]))
            for angle, side in ((q[3], 0.25), (q[4], -0.25))
        )
        return [body, *wheels]


def test_a_plant_draws_itself_live_recorded_and_as_a_ghost() -> None:
    run = pm.simulate(Drawn(), Follower(), PATH, dt=0.02, duration=4)
    drawn = figure(run.plant)
    times = np.array([0.0, 1.013, 4.0])
    rows = configurations(drawn, run.t, run.q, times)
    channels = links("meshcat/robot0", drawn, rows)
    nodes = [f"meshcat/robot0/visuals/{name}" for name in ("body", "left", "right")]
    expected = [(node, what) for node in nodes for what in ("position", "quaternion")]
    assert [(one.path, one.name) for one in channels] == expected
    for k in (0, 2):  # node and object together are where the plant says
        pose, expected = rows[k, :3], run.plant.drawing(run.q[0 if k == 0 else -1])
        node = pin.SE3(pin.utils.rotate("z", pose[2]), np.array([pose[0], pose[1], 0.0]))
        for i, placement in enumerate(expected):
            position, turned = channels[2 * i].values[k], channels[2 * i + 1].values[k]
            found = node * pin.SE3(pin.Quaternion(*np.roll(turned, 1)).matrix(), np.asarray(position))
            np.testing.assert_allclose(found.homogeneous, placement.homogeneous, rtol=0, atol=1e-12)
    half = (run.q[50] + 0.65 * (run.q[51] - run.q[50]))[3:]
    np.testing.assert_allclose(rows[1, 6:], half, rtol=0, atol=1e-12)
    with Viewer(Drawn()) as viewer:
        viewer.display(run.q[10])
        assert "robot0/visuals/left" in scene_text(viewer)
        before = scene_text(viewer)
        viewer.display(np.append(run.q[10, :3], [1.0, 0.0]))  # a wheel alone
        assert scene_text(viewer) != before
        recorded = viewer.record({"one": run, "two": driven()}, overlays=Overlays(desired=True))
    moving = {track["path"] for track in recorded.tracks}
    assert {f"meshcat/robot0/visuals/{name}" for name in ("body", "left", "right")} <= moving
    assert "meshcat/desired/visuals/left" in moving
    assert "meshcat/robot1/visuals/left" not in moving  # which has no drawing, and is a box


def scene_text(viewer: Viewer) -> str:
    return "".join(repr(command) for command in viewer._window.commands())


def test_a_start_is_completed_and_checked() -> None:
    class Held(TwoWheels):
        def check_start(self, q: Array, v: Array) -> None:
            if np.abs(self.project(q, v) - v).max() > 1e-9:
                raise pm.InvalidArgument("v0 does not roll")

    np.testing.assert_allclose(driven().v[0, 3:] * 0.1, [0.5 - 0.0625, 0.5 + 0.0625], atol=1e-12)
    sliding: Any = {"v0": [0.5, 0.2, 0.25, 0, 0]}
    with pytest.raises(pm.InvalidArgument, match="v0 does not roll"):
        pm.simulate(Held(), Follower(), PATH, dt=0.1, **sliding)
    free = pm.simulate(TwoWheels(), Follower(), PATH, dt=0.1, duration=0.1, **sliding)
    assert free.v[0].tolist() == sliding["v0"]
    with pytest.raises(pm.InvalidArgument, match=r"q0 has shape \(3,\), expected \(5,\)"):
        pm.simulate(Held(), Follower(), PATH, dt=0.1, q0=np.zeros(3))


class Sliding:
    """A mass under a stop: a step of its own, memory of what it hit, and a signal."""

    nq = nv = nu = 1
    coordinates = (Coordinate("way", "m"),)
    inputs = (Input("push", "N"),)

    def forward_dynamics(self, q: Array, v: Array, u: Array, f: Any = 0.0) -> Array:
        raise AssertionError("it has a step of its own")

    def integrate(self, q: Array, dq: Array) -> Array:
        return q + dq

    def difference(self, q0: Array, q1: Array) -> Array:
        return q1 - q0

    def initial_state(self, context: Context) -> int:
        return 0

    def step(self, t: float, q: Array, v: Array, u: Array, h: float, f: Any, memory: int) -> Step:
        v = v + h * (u + f(t, q, v))
        hit = bool(q[0] + h * v[0] > 1)
        return Step(np.minimum(q + h * v, 1.0), v * (not hit), memory + hit)

    def signals(self, t: float, q: Array, v: Array, u: Array, f: Any, memory: int) -> Any:
        return {"hits": ("", memory), "state": ("m", [q[0], v[0]])}


class Still:
    duration = 1.0

    def __call__(self, t: Any) -> Any:
        zero = np.zeros((*np.shape(t), 1))
        return type(PATH(0.0))(zero, zero, zero)


class Spring:
    def on_coordinates(self, t: float, q: Array, v: Array) -> Array:
        return -4 * q


def test_a_step_of_its_own_is_taken_with_its_memory_and_signals() -> None:
    push = pm.law(lambda *_: np.array([3.0]))
    run = pm.simulate(Sliding(), push, Still(), dt=0.1, substeps=2, forces=[Spring()], q0=[0.5], v0=[1.0])
    loop = Loop(Sliding(), push, None, (Spring(),), None, 2)
    rows = looped(loop, run.q[0], run.v[0], run.t, run.reference)
    for name in ("q", "v", "u", "a"):
        np.testing.assert_allclose(getattr(run, name), rows[name], rtol=0, atol=1e-14)
    assert run.a[0, 0] == pytest.approx(3 - 4 * 0.5)
    hits = run.signals["hits"].values
    assert (hits[0], np.diff(hits).min()) == (0, 0)
    assert hits[-1] > 0
    np.testing.assert_array_equal(run.signals["state"].values, np.hstack([run.q, run.v]))
    assert "push 3 N" in str(run)
    for chosen in (pm.rk4, constant_acceleration):
        with pytest.raises(
            pm.InvalidArgument, match="expected None because the plant, a Sliding, has its own step"
        ):
            pm.simulate(Sliding(), push, Still(), dt=0.1, integrator=chosen)


def test_a_plant_chooses_its_integrator() -> None:
    class Precise(TwoWheels):
        integrator = pm.rk4

    chosen, given, usual = (
        pm.simulate(plant, Follower(), PATH, dt=0.1, integrator=integrator).q
        for plant, integrator in ((Precise(), None), (TwoWheels(), pm.rk4), (TwoWheels(), None))
    )
    np.testing.assert_array_equal(chosen, given)
    assert np.abs(chosen - usual).max() > 1e-9


def plant_with(**changed: Any) -> Any:
    return type("Changed", (TwoWheels,), changed)()


def run_with(**changed: Any) -> pm.Rollout:
    return pm.simulate(plant_with(**changed), Follower(), PATH, dt=0.1)


test_a_plant_that_contradicts_itself_is_refused = refusals(
    (lambda: run_with(configuration_names=("x",)), "nq = 5 and 1 configuration_names"),
    (
        lambda: run_with(reference_sizes={5: 5}),
        r"trajectory at 201 times: q has shape \(201, 3\), expected \(201, 5",
    ),
    (lambda: run_with(step=lambda self, *_: 3), r"plant.step returned 3 at t = 0 s, expected a Step"),
    (lambda: run_with(start=property(lambda self: self.nothing)), r"has no start\(reference\), .*: give q0"),
)


class Telling(Follower):
    def __init__(self, *answers: Any) -> None:
        self.answers = answers

    def initial_state(self, context: Context) -> Any:
        return {"across": 0.0, "k": 0}

    def __call__(self, t: float, q: Array, v: Array, reference: Any, state: Any) -> tuple[Array, Any]:
        return np.zeros(2), state | {"k": state["k"] + 1}

    def signals(self, state: Any) -> Any:
        return self.answers[min(state["k"], len(self.answers)) - 1]


def telling(*answers: Any) -> pm.Rollout:
    plant = plant_with(signals=lambda self, t, q, v, u, f, memory: {"tread": ("N", 1.0)})
    return pm.simulate(plant, Telling(*answers), PATH, dt=0.1, duration=1)


test_signals_that_are_none_are_refused = refusals(
    (lambda: telling([1]), r"result of controller.signals is \[1\], expected a dict"),
    (lambda: telling({"a": 3}), r"controller.signals\['a'\] is 3, expected \(unit, value\)"),
    (
        lambda: telling({"a": ("m", np.eye(2))}),
        r"controller.signals\['a'\] has shape \(2, 2\), expected \(\) or",
    ),
    (
        lambda: telling({"a": ("m", 1)}, {}),
        r"controller.signals\['a'\] is missing at t = 0.1 s, expected of unit 'm'",
    ),
    (lambda: telling({"a": ("m", 1)}, {"a": ("m", [1, 2])}), r"is of unit 'm' and shape \(2,\) at t = 0.1 s"),
    (lambda: telling({"tread": ("m", 1)}), "plant and controller both have the signal 'tread'"),
)
