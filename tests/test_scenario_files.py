"""Parts as text: what a file states, what it says that is wrong, and what is shipped."""

import random
import tomllib
from collections.abc import Iterator
from copy import deepcopy
from datetime import date
from pathlib import Path
from typing import Any

import attrs
import numpy as np
import pytest

import pinmobile as pm
from pinmobile.cli.results import IdentifyPaths
from pinmobile.cli.scenario_file import LoadedFile, ScenarioFile, shipped_names
from pinmobile.controllers import Sampled, WheelSpeed
from pinmobile.parts import Child, InvalidEntries, Reader, schema_of, write_text
from pinmobile.wheels import MOTORS
from tests.drawing import APART, PARTS, drawn
from tests.wheeled import husky


def fields(part: Any) -> Any:
    """Return a part as nested tuples, with the bits of its numbers."""
    if attrs.has(type(part)):
        return (
            type(part),
            *(fields(getattr(part, one.name)) for one in attrs.fields(type(part)) if one.init),
        )
    if isinstance(part, np.ndarray | float):
        return np.shape(part), np.asarray(part).tobytes()
    return tuple(map(fields, part)) if isinstance(part, list | tuple) else part


@pytest.mark.parametrize("name", sorted(PARTS.keys() - APART))
def test_a_part_is_the_same_after_toml_bit_for_bit(name: str) -> None:
    rng, found = random.Random(name), 0
    holder = attrs.make_class("Holder", {"one": attrs.field(metadata={"declared": Child()})}, frozen=True)
    for _ in range(400):
        try:
            part = drawn(PARTS[name], rng)
        except (pm.InvalidArgument, ArithmeticError, AttributeError, RuntimeWarning):
            continue
        text = write_text(holder, Reader().tree(holder(part)))
        again = Reader().root(holder, tomllib.loads(text)).one
        assert fields(again) == fields(part), text
        found += 1
        if found == 3:
            break
    assert found


@pytest.mark.parametrize("name", shipped_names())
def test_shipped_scenarios_run_and_are_the_same_after_they_are_written(name: str, tmp_path: Path) -> None:
    opened = LoadedFile([name])
    file = tmp_path / "again.toml"
    file.write_text(opened.to_toml())
    again = LoadedFile([str(file)])
    assert again.to_toml() == opened.to_toml()
    short = {"duration": 3 * opened.content.dt}
    runs = [attrs.evolve(one.content, **short).simulate() for one in (opened, again)]
    assert runs[0].q.tobytes() == runs[1].q.tobytes()
    assert opened.points().scenarios


WRONG = """dt = 0.01
[robot]
type = "MobileRobot"
mas = 30
yaw_inertia = -1.3
[controller]
type = "computed-torq"
[trajectory]
type = "Tangent"
path = {type = "Circle", radius = "3 m", rate = 0.1, duration = 60}
[forces.gust]
type = "SinusoidalForce"
amplitude = [1, 0,
             0]
"""


def problems(*words: str) -> str:
    with pytest.raises(pm.InvalidArgument) as caught:
        LoadedFile(words).points()
    return str(caught.value)


def test_all_wrong_entries_are_told_at_once_with_their_lines(tmp_path: Path) -> None:
    file = tmp_path / "wrong.toml"
    file.write_text(WRONG)
    lines = [line.removeprefix(f"{file}:") for line in problems(str(file)).splitlines()]
    assert sorted(int(line.split(":")[0]) for line in lines) == [2, 4, 5, 7, 10, 11]
    told = "\n".join(lines)
    for words in (
        "4: robot.mas is unknown, MobileRobot has mass, yaw_inertia, ",
        "did you mean 'mass'?",
        "2: robot.mass is missing, expected a number > 0 [kg]: mass of the robot",
        "5: robot.yaw_inertia is -1.3, expected a number > 0 [kg m^2]",
        "7: controller is 'computed-torq', expected a controller, did you mean 'ComputedTorque'?",
        "10: trajectory.path.radius is '3 m', expected a number > 0 [m]",
        "11: forces.gust.frequency is missing, expected a number >= 0 [Hz]",
    ):
        assert words in told, words


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["controler.kp=9"], "controler.kp=9: controler is unknown, available: robot, controller, "),
        (["controller=pid2"], "controller is 'pid2', expected a controller, did you mean 'PID'?"),
        (["controller=PD(4, 4"], "controller is 'PD(4, 4', which cannot be read: '(' was never closed"),
        (["controller=PD(not 1, 4)"], "which cannot be read: not 1 is no number, text or part"),
        (["robot.mass=30 kg"], "robot.mass=30 kg: robot.mass is '30 kg', expected a number > 0 [kg]"),
        (["controller=mine:PD"], "code of the module 'mine', which runs only with --allow-code"),
        (["grid.robot.mas=[1, 2]"], "grid.robot.mas=[1, 2]: robot.mas is unknown, MobileRobot has mass, "),
        (['grid.controller=["PD(9, 9)", "PDD"]'], "controller is 'PDD', expected a controller, did you"),
        (["cases.heavy.robot.mass=-1"], "robot.mass is -1, expected a number > 0 [kg]"),
        (
            ["robot=WheeledRobot(MobileRobot.box(), WheelTable.differential(0.4, 0.1))"],
            "robot is a drive of type (2, 0), which cannot accelerate in every direction",
        ),
        (["grid=3"], "grid is 3, expected a table of PATH = VALUE"),
        (["rivalz"], "FILE is 'rivalz', neither a file nor a shipped scenario, did you mean 'rivals'?"),
        ([str(Path(__file__).parent)], "a folder, expected a scenario file; `pinmobile view` shows the run"),
        (["dt=0.1", "dt=0.01"], "the command has 'dt' twice, expected different names"),
        (["lecture", "other"], "'other' is a second FILE beside 'lecture', expected PATH=VALUE"),
    ],
)
def test_a_wrong_word_is_told_with_what_is_expected(words: list[str], said: str) -> None:
    assert said in problems(*words)


@pytest.mark.parametrize("text", ["a = [1", "robot.robot.robot = 1\nrobot = 2"])
def test_a_file_that_is_no_toml_is_told(text: str, tmp_path: Path) -> None:
    (tmp_path / "no.toml").write_text(text)
    assert "no.toml: " in problems(str(tmp_path / "no.toml"))


def mutated(tree: Any, rng: random.Random) -> Any:
    """Return a tree in which something is another thing."""
    tree = deepcopy(tree)
    places = [(at, key) for at in tables(tree) for key in at]
    at, key = rng.choice(places)
    odd: list[Any] = [None, 0, -1, 1e308, float("nan"), "", "PD", "PD(", "a:b", True, date(2026, 1, 1)]
    odd += [[], {}, [[1], "x"], {"type": 3}, {"x": "y"}, "rk4"]
    match rng.randrange(4):
        case 0:
            del at[key]
        case 1:
            at[f"{key}x"] = at.pop(key)
        case 2:
            other, name = rng.choice(places)
            at[key] = deepcopy(other.get(name))
        case 3:
            at[key] = rng.choice(odd)
    return tree


def tables(tree: Any) -> Iterator[dict[str, Any]]:
    if isinstance(tree, dict):
        yield tree
        for each in tree.values():
            yield from tables(each)
    elif isinstance(tree, list):
        for each in tree:
            yield from tables(each)


def test_wrong_trees_are_refused_as_wrong_entries_and_nothing_else() -> None:
    rng, refused = random.Random(0), 0
    files = ["lecture", "rivals", "mecanum", "velocity", "ensemble", "differential"]
    texts = [tomllib.loads(LoadedFile([name]).to_toml()) for name in files]
    for _ in range(120):
        try:
            Reader().root(ScenarioFile, mutated(rng.choice(texts), rng))
        except InvalidEntries:
            refused += 1
    assert 48 < refused < 120


def test_paths_change_what_stands_there_and_names_what_is_new() -> None:
    one = LoadedFile(["controller.kp=9", "controller.robot.mass=25", "robot.com.x=0.1"]).content
    assert (one.controller.kp, one.controller.kd, one.robot.com[0]) == (9.0, 4.0, 0.1)
    assert one.controller.robot == attrs.evolve(one.robot, mass=25.0)  # believes in 25 kg, the rest is so
    other = LoadedFile(
        [
            "controller=InputSaturation(PD((1, 2, 3), kd=4), [20, inf, 5])",
            "forces.wind=ConstantForce((1, 0, 0))",
        ]
    )
    assert other.content.controller.limits.tolist() == [20, np.inf, 5]
    assert other.content.controller.controller.kp.tolist() == [1, 2, 3]
    assert [*other.content.forces] == ["wind"]


def test_the_robot_of_the_file_stands_for_models_that_are_not_given() -> None:
    one = LoadedFile(["differential", "robot.table.wheels.left.radius=0.11", "robot.robot.mass=20"]).content
    assert isinstance(one.controller, pm.Backstepping)
    assert one.controller.robot is one.robot
    assert [wheel.radius for wheel in one.robot.table.wheels] == [0.11, 0.1]
    assert one.robot.robot.mass == 20
    by = LoadedFile(
        ["differential", "controller=OdometryFeedback(Backstepping(UnicycleTracking()), ticks=1024)"]
    ).content
    assert by.controller.table is by.robot.table


def test_robots_of_files_and_lists_of_parts_are_stated(tmp_path: Path) -> None:
    (tmp_path / "husky.urdf").write_text(husky())
    text = f"WheeledRobot.from_urdf({str(tmp_path / 'husky.urdf')!r}, rollers={{}})"
    laws = (
        "controller=WheelSpeed(UnicycleTracking(), kp=1)",
        "forces=[ConstantForce((1, 0, 0)), PayloadForce(3, (0, 0), 0)]",
    )
    opened = LoadedFile([f"robot={text}", "robot.table.wheels.wheel_0.radius=0.2", *laws])
    assert opened.content.robot.ground.slips
    assert [wheel.radius for wheel in opened.content.robot.table.wheels][:2] == [0.2, 0.1651]
    assert opened.content.forces[1].mass == 3
    (tmp_path / "again.toml").write_text(opened.to_toml())
    again = LoadedFile([str(tmp_path / "again.toml")])
    assert (again.to_toml(), again.content.robot) == (opened.to_toml(), opened.content.robot)


def test_grids_and_cases_change_what_they_name_and_no_model() -> None:
    with pytest.raises(pm.InvalidArgument, match=r"robot\.mass is an axis of the grid too, expected one of"):
        LoadedFile(["rivals", "grid.mass=[30, 40]"]).points()
    points = LoadedFile(
        [
            "rivals",
            "grid.mass=[30, 40]",
            "cases={nominal = {}, push = {forces.push = 'ConstantForce((10, 0, 0))'}}",
        ]
    ).points()
    for k, scenario in enumerate(points.scenarios):
        at = {
            name: axis.values[i] for (name, axis), i in zip(points.axes.items(), points.index(k), strict=True)
        }
        assert scenario.robot.mass == at["mass"]
        assert set(scenario.forces) == ({"push"} if at["case"] == "push" else set())
        if at["controller"] == "computed torque":
            assert scenario.controller.robot.mass == 30
    assert points.axes["mass"].unit == "kg"


def test_a_slower_law_stands_around_a_controller_and_in_one() -> None:
    around, inside = (
        LoadedFile(["differential", f"controller={text}"]).content.controller
        for text in (
            "Sampled(WheelSpeed(UnicycleTracking(), kp=5), 2)",
            "WheelSpeed(Sampled(UnicycleTracking(), 2), kp=5)",
        )
    )
    assert isinstance(around, Sampled)
    assert isinstance(around.controller, WheelSpeed)
    assert (inside.law.every, type(inside.law.controller), inside.kp) == (2, pm.UnicycleTracking, 5)


def test_text_makes_what_python_makes() -> None:
    table = "WheelTable.mecanum(0.4, 0.5, radius=0.1, motor=wheels.MOTORS['pololu_37d_50_12v'])"
    text = f"WheeledRobot(MobileRobot(30, 1.3), {table})"
    made = LoadedFile([f"robot={text}", "controller.kp=25"]).content.robot
    volts = LoadedFile([f"robot={text}.by_voltage()", "controller=TorqueToVoltage(ComputedTorque())"]).content
    assert isinstance(made, pm.WheeledRobot)
    assert made.table.source == pm.WheelTable.mecanum(0.4, 0.5, 0.1).source
    assert made.table.wheels[0].motor == MOTORS["pololu_37d_50_12v"]
    assert volts.robot == made.by_voltage()
    assert volts.controller.controller.robot == made
    alone = LoadedFile(["robot=WheelTable.differential(0.5, 0.1)"], kind=IdentifyPaths)
    assert alone.content.robot == pm.WheelTable.differential(0.5, 0.1)


CODE = """
from dataclasses import dataclass
from typing import Any

import helper
from pinmobile.parts import number, part

@part
class Pull:
    gain: float = number(unit="N/m", above=0.0, doc="gain")
    robot: Any = None

    def initial_state(self, context):
        return None

    def __call__(self, t, q, v, reference, state):
        return helper.SIGN * self.gain * (reference.q - q) + 9 * (reference.v - v), state

@dataclass(frozen=True)
class Slow:
    controller: Any
    share: float = 0.9

    def initial_state(self, context):
        return self.controller.initial_state(context)

    def __call__(self, t, q, v, reference, state):
        u, state = self.controller(t, q, v, reference, state)
        return self.share * u, state

def gust(t, pose, rate):
    return 0 * pose

def broken(:
"""


def test_users_parts_run_where_they_are_allowed(tmp_path: Path) -> None:
    (tmp_path / "helper.py").write_text("SIGN = 1.0")
    (tmp_path / "parts_of_mine.py").write_text(CODE.replace("def broken(:", ""))
    (tmp_path / "damaged.py").write_text(CODE)
    (tmp_path / "halved.py").write_text("\n\nSHARE = 1 / 0\n")
    file = tmp_path / "mine.toml"
    lines = (
        'dt = 0.01\nforces.wind = "parts_of_mine:gust"\n[controller]\ntype = "parts_of_mine:Pull"\ngain = 9\n'
    )
    file.write_text(lines)
    assert "runs only with --allow-code" in problems(str(file))
    opened = LoadedFile([str(file), "controller.gain=16"], allow_code=True)
    assert opened.content.controller.gain == 16
    assert opened.content.simulate().max_error()[0] < 0.1
    around = "controller=parts_of_mine:Slow(parts_of_mine:Pull(9), share=0.8)"
    for one in (
        opened,
        LoadedFile([str(file), around.replace("parts_of_mine:Pull(9)", "PD(9, 9)")], allow_code=True),
    ):
        (tmp_path / "again.toml").write_text(one.to_toml())
        assert LoadedFile([str(tmp_path / "again.toml")], allow_code=True).to_toml() == one.to_toml()
        assert one.content.simulate().max_error()[0] < 0.3
    for old, new, said in (
        ("gain = 9", "gain = -9", "controller.gain is -9, expected a number > 0 [N/m]"),
        ("parts_of_mine:Pull", "damaged:Pull", "which fails: SyntaxError"),
        ("parts_of_mine:Pull", "halved:Pull", "which fails at halved.py:3: ZeroDivisionError"),
        ("parts_of_mine:Pull", "parts_of_mine:Push", "which fails: AttributeError"),
        ("parts_of_mine:Pull", "nothing_of_mine:Push", "which fails: ModuleNotFoundError"),
    ):
        file.write_text(lines.replace(old, new))
        with pytest.raises(pm.InvalidArgument, match=r".") as caught:
            LoadedFile([str(file)], allow_code=True)
        assert said in str(caught.value)


def test_the_schema_has_each_part_with_its_bounds() -> None:
    schema = schema_of(ScenarioFile)
    radius = schema["$defs"]["Circle"]["properties"]["radius"]
    assert radius["anyOf"][0] == {"type": "number", "exclusiveMinimum": 0.0}
    assert "[m]" in radius["description"]
    number, each, matrix, _ = schema["$defs"]["PD"]["properties"]["kp"]["anyOf"]
    assert number == each["items"] == {"type": "number", "minimum": 0.0}
    assert matrix["items"]["items"] == {"type": "number"}, "the bounds of a gain apply to its diagonal"
    assert {"$ref": "#/$defs/AnyController"} in schema["properties"]["controller"]["anyOf"]
    names = schema["$defs"]["AnyController"]["properties"]["type"]["anyOf"][0]["enum"]
    assert {"PD", "InputSaturation"} < set(names) < set(schema["$defs"])
    assert not {"Circle", "ConstantForce", "UnicycleTracking"} & set(names)
