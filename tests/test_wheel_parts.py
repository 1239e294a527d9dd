"""Robots on wheels as parts: their numbers by path, laws on symbols, grounds of one's own, values."""

import pickle
from typing import Any

import numpy as np
import pytest

from pinmobile import Coulomb, InvalidArgument, Motor, Rolling, VelocityRobot, WheeledRobot, WheelTable, parts
from pinmobile.arrays import Array
from pinmobile.compiled import symbols
from pinmobile.compiled.symbolic import entries
from pinmobile.compiled.tape import Node, Tape, evaluate
from pinmobile.controllers import Backstepping, UnicycleTracking
from pinmobile.loop import Engine, simulate
from pinmobile.paths import Circle
from pinmobile.trajectories import Tangent
from pinmobile.wheels import Ramp, Wheel, WheeledDynamics, WheelFriction
from tests.refusals import begun, refusals
from tests.wheeled import BODY, WHEEL as OWN

MOTOR = Motor(resistance=1.2, torque_constant=0.03, voltage=24.0, gear=20.0, viscous=1e-5, coulomb=0.01)
WRONG: Any = 3
PAIR = WheelTable.differential(0.5, 0.1, supports=[(0.2, 0), (-0.2, 0)], motor=MOTOR, **OWN)
CAR = WheelTable.car(0.6, 0.4, 0.1, **OWN)
ROBOTS: dict[str, Any] = {
    "differential": WheeledRobot(BODY, PAIR),
    "mecanum": WheeledRobot(BODY, WheelTable.mecanum(0.5, 0.4, 0.1, **OWN)),
    "car": WheeledRobot(BODY, CAR),
    "slipping": WheeledRobot(BODY, PAIR, Coulomb(0.6)),
    "slipping, own friction": WheeledRobot(BODY, PAIR, Coulomb()),
    "slipping car": WheeledRobot(BODY, CAR, Coulomb()),
    "volts": WheeledRobot(BODY, PAIR).by_voltage(),
    "slipping volts": WheeledRobot(BODY, PAIR, Coulomb()).by_voltage(),
}


def of_wheels(robot: Any) -> dict[str, float]:
    """Return the numbers of wheels, motors and ground that may differ, by path."""
    found = parts.numbers(robot)
    return {path: float(leaf.value) for path, leaf in found.items() if "table" in path or "ground" in path}


def on_symbols(robot: Any, answer: Any, *state: Array) -> Array:
    """Return what a function of a robot and a state answers, from a tape of which all of these are inputs."""
    tape, values = Tape(), of_wheels(robot)
    flat = [float(x) for row in state for x in row]
    first = [0, *np.cumsum([len(row) for row in state])]
    rows = [
        symbols([tape.input("state", i + k) for k in range(len(row))], (len(row),))
        for i, row in zip(first, state, strict=False)
    ]
    given = {
        path: symbols([tape.input("row", k)], ()) if x or "spin" in path else 0.0
        for k, (path, x) in enumerate(values.items())
    }
    found = entries(answer(parts.replace(robot, given, nominal=True), *rows)).reshape(-1)
    inputs = {("row", k): x for k, x in enumerate(values.values())}
    inputs |= {("state", k): x for k, x in enumerate(flat)}
    wanted = [(x if type(x) is Node else tape.const(float(x))).index for x in found]
    return np.array(evaluate(tape, wanted, inputs))


def state_of(robot: Any) -> tuple[Array, Array, Array]:
    rng = np.random.default_rng(3)
    wheeled = getattr(robot, "wheeled", robot)
    q = 0.2 * rng.normal(size=robot.nq)
    v = WheeledRobot(wheeled.robot, wheeled.table).project(q, rng.normal(size=robot.nv))
    return q, v, rng.normal(size=robot.nu)


@pytest.mark.parametrize("name", ROBOTS)
def test_on_symbols_a_robot_moves_as_on_numbers(name: str) -> None:
    robot = ROBOTS[name]

    def moved(one: Any, q: Any, v: Any, u: Any) -> Any:
        law = one.law
        if not hasattr(law, "step"):
            return law.forward_dynamics(q, v, u)
        return law.step(0.0, q, v, u, 0.01, lambda *_: 0.0, robot.initial_state(None)).v

    state = state_of(robot)
    np.testing.assert_allclose(on_symbols(robot, moved, *state), moved(robot, *state), rtol=1e-9, atol=1e-9)


WITHIN: dict[str, tuple[tuple[str, ...], Any]] = {
    "inverse_dynamics": (("mecanum",), lambda q, v, u: (q, v, u[:3])),
    "reduced": (("differential", "car", "mecanum"), lambda q, v, u: (q, v)),
    "torques": (
        ("differential", "mecanum", "slipping"),
        lambda q, v, u: (q, v, 0.1 * np.arange(min(len(u), 3))),
    ),
    "allocate_scaled": (("differential", "mecanum"), lambda q, v, u: (q, np.array([3.0, 0.0, 0.5]))),
    "independent": (("differential", "car"), lambda q, v, u: (q, v)),
    "wheel_rates": (("differential", "mecanum"), lambda q, v, u: (np.array([0.5, 0.0, 0.2]),)),
    "odometry": (("differential", "mecanum"), lambda q, v, u: (v[3:],)),
    "volts_for": (("volts",), lambda q, v, u: (v, u)),
    "torques_at": (("volts", "slipping volts"), lambda q, v, u: (v, u)),
}


@pytest.mark.parametrize(("name", "kind"), [(name, kind) for name in WITHIN for kind in WITHIN[name][0]])
def test_methods_that_a_law_may_call_follow_symbols(name: str, kind: str) -> None:
    robot = ROBOTS[kind]
    given = WITHIN[name][1](*state_of(robot))

    def asked(one: Any) -> Any:
        answer = getattr(one, name)(*given)
        rows = answer if isinstance(answer, tuple) else (answer,)
        return np.concatenate([np.reshape(x, (-1,)) for x in rows])

    np.testing.assert_allclose(on_symbols(robot, asked), asked(robot), rtol=1e-9, atol=1e-9)


def test_structure_follows_the_numbers_of_a_robot_on_symbols() -> None:
    robot, tape = ROBOTS["car"], Tape()
    given = {path: symbols([tape.input("row", 0)], ()) for path in of_wheels(robot)}
    symbolic = parts.replace(robot, given, nominal=True)
    for name in ("nq", "nv", "nu", "coordinates", "inputs", "mobility", "footprint", "reference_sizes"):
        assert getattr(symbolic, name) is getattr(robot, name)
    assert symbolic.law is symbolic.array_dynamics
    assert robot.law is robot
    assert symbolic.table.axes is robot.table.axes


def test_numbers_have_paths() -> None:
    robot = ROBOTS["volts"]
    found: Any = parts.numbers(robot)
    assert found["wheeled.table.wheels.left.motor.resistance"].declared.bound == "> 0"
    assert found["wheeled.table.wheels.left.motor.gear"].value == MOTOR.gear
    assert parts.find(robot, "left.radius").path == "wheeled.table.wheels.left.radius"
    assert parts.find(ROBOTS["slipping"], "ground.mu").leaf.value == 0.6
    assert not any(path.endswith((".mass", ".angle")) for path in found if "table" in path)
    assert found["wheeled.table.wheels.left.friction.rolling"].value == 0.01
    car = WheeledRobot(BODY, WheelTable.car(0.6, 0.4, 0.1, motor=MOTOR, **OWN)).by_voltage()
    assert car.motor_paths == ("wheeled.table.couplings.drive.motor",)
    assert (
        parts.replace(car, {f"{car.motor_paths[0]}.resistance": 2.0}).table.actuators[0].motor.resistance == 2
    )


@pytest.mark.parametrize("name", ROBOTS)
def test_robots_and_what_they_are_made_of_are_values(name: str) -> None:
    robot = ROBOTS[name]
    for _, part in parts.parts_of(robot):
        twin = pickle.loads(pickle.dumps(part))
        assert twin == part
        assert hash(twin) == hash(part)
    other = parts.replace(robot, {next(path for path in of_wheels(robot) if path.endswith("radius")): 0.11})
    assert other != robot
    assert other.table.wheels[0] != robot.table.wheels[0]


@parts.part
class Viscous:
    """A ground whose force on a wheel is in proportion to its slip, along and across."""

    c: float = parts.number(default=500.0, unit="N s/m", above=0, doc="force per slip")

    def dynamics(self, wheeled: Any) -> "ViscousDynamics":
        """Return the dynamics of a robot on it."""
        own = ViscousDynamics(wheeled, wheeled.robot.array_dynamics)
        object.__setattr__(own, "c", self.c)
        return own


class ViscousDynamics(WheeledDynamics):
    """A robot whose wheels slip against a viscous film."""

    c: Any

    def _rows(self, state: Any) -> list[Any]:
        return [row for row in self.rows(state, across=True) if row.wheel >= 0]

    def forward_dynamics(self, q: Any, v: Any, u: Any, f: Any = 0.0) -> Any:
        """Return the acceleration, shape (nv,)."""
        state = self.state(q, v)
        force = self.input_force(state, u, f)
        for row in self._rows(state):
            pull = -self.c * row.slip(state)
            for i, x in enumerate([*row.base, *row.joints]):
                force[i] = force[i] + x * pull
        rest = [a - b for a, b in zip(force, self.effects(state, q), strict=True)]
        M = np.stack([np.stack([x + 0.0 * q[0] for x in row]) for row in self.inertia(state, q)])
        a = np.linalg.solve(M, np.stack([x + 0.0 * q[0] for x in rest]))
        return self.in_plane(state, [a[i] for i in range(self.nv)], q)

    def signals(self, t: Any, q: Any, v: Any, u: Any, f: Any, memory: Any) -> dict[str, tuple[str, Any]]:
        """Return the slip of each wheel."""
        state = self.state(q, v)
        slips = [row.slip(state) + 0.0 * q[0] for row in self._rows(state)]
        return {"slip": ("m/s", np.stack(slips))}


def test_a_ground_of_ones_own_is_one_class() -> None:
    """The stiffer the film, the less the wheels slip."""
    slips = []
    for c in (30.0, 200.0):
        robot = WheeledRobot(BODY, PAIR, Viscous(c))
        assert not hasattr(robot, "project")
        assert not hasattr(robot, "step")
        rolling = WheeledRobot(BODY, PAIR)
        law = Backstepping(UnicycleTracking(), rolling)
        run = simulate(robot, law, Tangent(Circle(1.5, 0.4, 0.6)), dt=0.002, engine=Engine.PYTHON)
        slips.append(np.abs(run.signals["slip"].values[100:]).max())
        assert [one.name for one in robot.metrics] == ["effort", "load", "tip over", "slip"]
    assert 0 < slips[1] < 0.3 * slips[0] < 0.3
    with pytest.raises(InvalidArgument, match="do not support electric motors"):
        robot.by_voltage()
    with pytest.raises(TypeError, match="Viscous has no field 'ramp'"):
        robot.on_ramp(0.1)
    assert "ground.c" in parts.numbers(robot)


test_what_is_declared_is_checked = refusals(
    (lambda: WheeledRobot(WRONG, PAIR), "robot is 3, expected a MobileRobot"),
    (lambda: WheeledRobot(BODY, PAIR, 3), "ground is 3, expected a ground with dynamics(wheeled)"),
    (lambda: Wheel("a.b", 0, 0, 0.1), "name is 'a.b', expected a word without /"),
    (lambda: WheelFriction(mu=-1), "mu is -1.0, expected >= 0"),
    (lambda: Motor(efficiency=1.1), "efficiency is 1.1, expected > 0 and <= 1"),
    (lambda: Rolling(ramp=WRONG), "ramp is 3, expected a Ramp(angle, direction) or None"),
    (lambda: Ramp(1.6), "angle is 1.6 rad, expected < 1.57079633"),
    (lambda: parts.evolved(PAIR, wheels={"a": WRONG}), "wheels.a is 3, expected Wheel(...)"),
    (lambda: VelocityRobot([1, 1, 0, 1, 0, 0]), "theta[5] is 0.0, expected > 0"),
    by=begun,
)


def test_theta_has_a_name_for_each_entry() -> None:
    robot = VelocityRobot([0.26, 0.25, 0.03, 1.1, 0.2, 1.2], ahead=0.1)
    assert [*parts.named(robot)][1] == "theta.theta_1"
    assert parts.find(robot, "theta.theta_3").label == "theta_3"
    tape = Tape()
    theta = symbols([tape.input("row", k) for k in range(6)], (6,))
    symbolic = parts.replace(robot, {"theta": theta}, nominal=True)
    state = np.array([0.1, 0.2, 0.3]), np.array([0.5, 0.1, 0.4]), np.array([0.6, 0.2])
    found = entries(symbolic.forward_dynamics(*state)).reshape(-1)
    inputs = {("row", k): x for k, x in enumerate(robot.theta)}
    got = evaluate(tape, [x.index for x in found], inputs)
    np.testing.assert_allclose(got, robot.forward_dynamics(*state), rtol=1e-13)
