"""Scenario files that name a user's parts: refused, allowed, and the same on workers elsewhere."""

import re
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pinmobile import InvalidArgument, Sweep
from pinmobile.cli.scenario_file import read_grid
from pinmobile.cli.tables import Code
from pinmobile.loop import part_of
from pinmobile.loop._run import way_of
from pinmobile.loop._simulate import COMPILED
from pinmobile.sweeps import Points
from tests.test_cli import typed

ROOT = Path(__file__).parents[1]

# The parts of a user, in two modules: one imports the other, which lies beside it.
PARTS = '''"""Parts of mine."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from mending import dead

from pinmobile.parts import gain, number, part
from pinmobile.trajectories import Reference

with Path(__file__).with_name("ran").open("a") as _file:
    _file.write("x")


@part
class PID:
    kp: Any = gain()
    kd: Any = gain()
    ki: Any = number(default=1.0, unit="1/s", doc="gain of the integral")

    def initial_state(self, context):
        return {"sum": np.zeros(3), "u": np.zeros(3), "dt": context.dt, "difference": context.difference}

    def __call__(self, t, q, v, reference, state):
        error = state["difference"](q, reference.q)
        u = self.kp * error + self.kd * (reference.v - v) + state["sum"]
        return u, state | {"sum": state["sum"] + state["dt"] * self.ki * error, "u": u}

    def applied(self, u, state):
        return state | {"sum": state["sum"] + state["dt"] * 2.0 * (u - state["u"])}


@dataclass(frozen=True)
class Sliding:
    robot: Any
    slope: float
    reach: float

    def initial_state(self, context):
        return context.difference

    def __call__(self, t, q, v, reference, state):
        rate = reference.v - v
        surface = rate + self.slope * state(q, reference.q)
        a = reference.a + self.slope * rate + self.reach * np.tanh(surface / 0.1)
        return self.robot.inverse_dynamics(q, v, a), state


@dataclass(frozen=True)
class Deadband:
    controller: Any
    width: float = 0.0

    def __post_init__(self):
        if self.width < 0:
            raise ValueError("width must not be below zero")

    def initial_state(self, context):
        return self.controller.initial_state(context)

    def __call__(self, t, q, v, reference, state):
        u, state = self.controller(t, q, v, reference, state)
        return dead(u, self.width), state


@part
class Gust:
    strength: Any = number(unit="N", lower=0.0, doc="largest force of the gust")
    period: Any = number(default=2.0, unit="s", above=0.0)

    def __call__(self, t, pose, rate):
        push = self.strength * np.sin(2 * np.pi * t / self.period) + 0 * pose[..., 0]
        return np.stack([push, 0 * push, 0 * push], axis=-1)


@dataclass(frozen=True)
class Wave:
    amplitude: float
    duration: float = 6.0

    def __call__(self, t):
        return self.derivative(t, 0)

    def derivative(self, t, order):
        t = np.asarray(t, float)
        along = t if order == 0 else np.full_like(t, float(order == 1))
        return np.stack([along, self.amplitude * np.sin(t + order * np.pi / 2)], axis=-1)


@dataclass(frozen=True)
class Turning:
    curve: Any
    rate: float

    @property
    def duration(self):
        return self.curve.duration

    def __call__(self, t):
        t = np.asarray(t, float)
        angles = self.rate * t, np.full_like(t, self.rate), 0 * t
        rows = [np.stack([*self.curve.derivative(t, k).T, a], axis=-1) for k, a in enumerate(angles)]
        return Reference(*rows)


@dataclass(frozen=True)
class Puck:
    mass: float
    nq = nv = nu = 3
    coordinate_names, coordinate_units = ("x", "y", "psi"), ("m", "m", "rad")

    def forward_dynamics(self, q, v, u, f=0.0):
        return (u + f) / np.asarray(self.mass)[..., None]

    def integrate(self, q, dq):
        return q + dq

    def difference(self, q0, q1):
        return q1 - q0

    def pose(self, q):
        return q

    def rate(self, q, v):
        return v

    def effort(self, q, wrench):
        return wrench


def halfway(acceleration, t, q, v, dt):
    middle = v + 0.5 * dt * acceleration(t, q, v)
    return q + dt * middle, v + dt * acceleration(t + 0.5 * dt, q + 0.5 * dt * v, middle)


_HIDDEN = Wave(1.0)
'''
MENDING = "import numpy as np\n\n\ndef dead(u, width):\n    return np.where(np.abs(u) < width, 0.0, u)\n"
FILE = """
[trajectory]
type = "parts:Wave"
amplitude = 0.5
heading = {type = "parts:Turning", rate = 0.2}
[controller]
type = "parts:Deadband"
width = 0.01
controller = {type = "parts:PID", kp = [120, 120, 4], kd = [120, 120, 4], ki = 3}
[forces.gust]
type = "parts:Gust"
strength = 2
[loop]
integrator = "parts:halfway"
[spread]
ki = {percent = 20}
strength = {uniform = [1, 2]}
mass = {percent = 10}
[ensemble]
n = 12
[grid]
"controller.controller.ki" = [1, 3]
"forces.gust.period" = [1, 2]
"""


@pytest.fixture
def file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    for name in ("parts", "mending", "laws", "laws.parts"):
        monkeypatch.delitem(sys.modules, name, raising=False)
    (tmp_path / "parts.py").write_text(PARTS)
    (tmp_path / "mending.py").write_text(MENDING)
    (tmp_path / "mine.toml").write_text(FILE)
    return tmp_path / "mine.toml"


def read(file: Path, old: str = "", new: str = "") -> Points:
    """Return the grid of the file, changed, with its code allowed."""
    file.write_text(FILE.replace(old, new) if old else FILE)
    return read_grid(file, Code(file.parent))


def swept(
    capsys: pytest.CaptureFixture[str], file: Path, *words: str, out: str = "out"
) -> tuple[int, str, str]:
    return typed(capsys, "sweep", str(file), "--out", str(file.parent / out), *words)


@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        (
            "",
            "",
            "mine.toml:3: type of [trajectory] is 'parts:Wave', code of the module 'parts', which is not",
        ),
        ('type = "parts:Wave"\namplitude = 0.5', "duration = 6", "mine.toml:4: heading of [trajectory] is "),
    ],
)
def test_code_is_refused_before_anything_of_it_is_run(
    capsys: pytest.CaptureFixture[str], file: Path, old: str, new: str, text: str
) -> None:
    file.write_text(FILE.replace(old, new))
    modules, path = set(sys.modules), list(sys.path)
    code, out, err = swept(capsys, file)
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert text in err
    assert f"look at that module, then type 'pinmobile sweep {file} --allow-code'" in err
    assert not (file.parent / "ran").exists()
    assert not (file.parent / "out").exists()
    assert (not {name for name in set(sys.modules) - modules if "parts" in name}, sys.path) == (True, path)


@pytest.mark.parametrize(
    "lines",
    [
        '[controller]\ntype = "parts:PID"',
        '[controller]\ntype = "saturated"\nlimits = 3\ncontroller = {type = "parts:PID"}',
        '[controller]\ntype = "saturated"\nlimits = [{type = "parts:PID"}]',
        '[robot]\ntype = "parts:Robot"',
        '[loop]\nintegrator = "parts:halfway"',
        '[loop]\nintegrator = {type = "parts:Halfway", order = 2}',
        '[forces]\nwind = "parts:gust"',
        '[forces]\nwind = {type = "parts:gust"}',
        '[grid]\n"controller.type" = ["pd", "parts:PID"]',
        '[grid]\n"controller.controller.type" = ["parts:PID"]\n[controller]\ntype = "saturated"',
        '[grid]\n"loop.integrator" = ["rk4", "parts:PID"]',
        '[grid]\n"forces.wind" = ["parts:PID"]',
        '[grid]\n"trajectory.heading" = [{type = "parts:PID"}]',
    ],
)
def test_code_is_refused_wherever_it_is_named(file: Path, lines: str) -> None:
    file.write_text(lines + "\n")
    with pytest.raises(
        InvalidArgument, match=r"^mine\.toml:\d: .* is 'parts:\w+', code of the module 'parts'"
    ):
        read_grid(file)
    assert not (file.parent / "ran").exists()


def test_a_users_parts_run_from_a_scenario_file(capsys: pytest.CaptureFixture[str], file: Path) -> None:
    path = list(sys.path)
    code, out, err = swept(capsys, file, "--allow-code", "--chunk", "5")
    assert (code, err) == (0, "")
    found = Sweep.open(file.parent / "out" / "sweep.zarr")
    assert dict(found.dataset.sizes)["forces.gust.period"] == 2
    assert np.isnan(found.dataset.diverged_at).all()
    assert found.dataset.max_distance.max() < 0.2
    assert sys.path == path
    again = swept(capsys, file, "--allow-code")
    assert again[:2] == (0, out)


def test_the_parts_are_what_the_file_says_and_are_compiled(file: Path) -> None:
    made = read(file)
    first: Any = made.scenarios[0]
    last: Any = made.scenarios[-1]
    assert [
        type(part).__name__ for part in (first.controller, first.controller.controller, first.trajectory)
    ] == [*("Deadband", "PID", "Turning")]
    assert (first.controller.width, first.controller.controller.kp.tolist()) == (0.01, [120, 120, 4])
    assert [(each.controller.controller.ki, each.forces["gust"].period) for each in (first, last)] == [
        (1, 1),
        (3, 2),
    ]
    assert (type(first.trajectory.curve).__name__, first.trajectory.curve.amplitude) == ("Wave", 0.5)
    assert first.integrator.__name__ == "halfway"
    assert np.ptp(last.draws()["ki"]) < 1.2
    assert all(2.4 <= ki <= 3.6 for ki in last.draws()["ki"])
    assert way_of(first).engine is COMPILED


def test_the_file_of_the_readme_is_a_grid(file: Path) -> None:
    (text,) = re.findall(r"```toml\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)
    (file.parent / "mine.py").write_text(PARTS)
    made = read_of(file, text)
    assert [each.forces["gust"].period for each in made.scenarios] == [1, 2]
    assert type(made.scenarios[0].controller).__name__ == "Deadband"


def test_a_part_that_takes_a_robot_gets_that_of_the_file(file: Path) -> None:
    law = '[controller]\ntype = "parts:Sliding"\nslope = 2\nreach = 3\n[robot]\nmass = 21'
    file.write_text(
        f"{law}\n[trajectory]\nduration = 6\n[spread]\nreach = {{percent = 10}}\n[ensemble]\nn = 3"
    )
    (made,) = read_grid(file, Code(file.parent)).scenarios
    assert (made.controller.robot is made.robot, made.robot.mass) == (True, 21)
    assert set(made.spread) == {"reach"}


def test_the_librarys_parts_stand_within_a_users_and_around_one(file: Path) -> None:
    law = 'type = "parts:Deadband"\ncontroller = {type = "computed-torque", kp = 9, model_mass = 33}'
    (made,) = read_of(file, f"[controller]\n{law}\n[trajectory]\nduration = 6\n[ensemble]\nn = 3").scenarios
    assert (made.controller.controller.kp, made.controller.controller.robot.mass) == (9, 33)
    law = 'type = "saturated"\nlimits = 50\ncontroller = {type = "pd", kp = 9, kd = [9, 9, 1]}'
    force = '[forces]\nwind = {type = "constant", force = [1, 0, 0]}'
    file.write_text(f"[controller]\n{law}\n{force}\n[trajectory]\nduration = 6\n[ensemble]\nn = 3")
    (made,) = read_grid(file).scenarios  # no code in it
    assert (made.controller.limits, made.controller.controller.kp) == (50, 9)
    assert made.forces["wind"].force.tolist() == [1, 0, 0]


def read_of(file: Path, text: str) -> Points:
    file.write_text(text)
    return read_grid(file, Code(file.parent))


def test_a_users_controller_is_compared_with_the_librarys(file: Path) -> None:
    made = read_of(
        file,
        "[controller]\nkp = 100\nkd = [100, 100, 1]\nki = 2\nmodel_mass = 31\n[trajectory]\nduration = 6\n"
        "[spread]\nki = {percent = 5}\ncontroller.mass = {percent = 5}\n[ensemble]\nn = 3\n"
        '[grid]\n"controller.type" = ["pd", "computed-torque", "parts:PID"]',
    )
    pd, torque, pid = made.scenarios
    assert [type(each.controller).__name__ for each in made.scenarios] == ["PD", "ComputedTorque", "PID"]
    assert (pid.controller.ki, torque.controller.robot.mass) == (2, 31)
    assert [set(each.spread) for each in (pd, torque, pid)] == [set(), {"controller.mass"}, {"ki"}]
    for key, text in (("ki = 2", "kl = 2"), ("ki = {", "kl = {")):
        file.write_text(file.read_text().replace(key, text))
        with pytest.raises(InvalidArgument, match=r"^mine\.toml:\d+: unknown .* 'kl'"):
            read_grid(file, Code(file.parent))
        file.write_text(file.read_text().replace(text, key))


@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        (
            "parts:Wave",
            "parst:Wave",
            r"^mine.toml:3: parst:Wave cannot be loaded: it raises Modul",
        ),
        (
            "parts:Deadband",
            "parts:Deadbond",
            r"^mine.toml:7: unknown name in .*parts\.py 'Deadbond', did you mean 'Deadband'",
        ),
        ("parts:Wave", "parts:", "^mine.toml:3: 'parts:' names no part, expected 'module:Name'"),
        (
            "parts:Wave",
            "../parts:Wave",
            "^mine.toml:3: '../parts:Wave' names no part, expected 'module:Name'",
        ),
        (
            "width = 0.01",
            "wdth = 0.01",
            r"^mine.toml:8: unknown argument of parts:Deadband 'wdth', did you mean 'width'\? available: wi",
        ),
        (
            "amplitude = 0.5\n",
            "",
            "^mine.toml:3: parts:Wave lacks 'amplitude', expected a key of that name; it takes",
        ),
        (
            "width = 0.01",
            "width = -1",
            r"^mine.toml:7: parts:Deadband cannot be made: it raises ValueError: width must not",
        ),
        ('"parts:Gust"', "3", r"^mine.toml:\d+: forces.gust has the type 3, expected"),
        (
            'type = "parts:Gust"\n',
            "",
            r"^mine.toml:\d+: forces.gust is .*, a table without type, expected type =",
        ),
        ("halfway", "_HIDDEN", "integrator is Wave"),
        ("kd = [", "kb = [", "^mine.toml:9: unknown argument of parts:PID 'kb'"),
        (
            "strength = {uni",
            "strenght = {uni",
            r"^mine.toml:17: unknown parameter in spread 'strenght', did you mean 'strength' or 'start'\? ",
        ),
        (
            "strength = {uniform = [1, 2]}",
            "strength = {uniform = [-1, 2]}",
            r"spread\['strength'\] reaches -1 N",
        ),
        ('"halfway"', '"halfway"\nsteps = 2', "unknown key 'steps' in .loop."),
    ],
)
def test_what_is_wrong_with_a_users_part_is_said_in_one_sentence(
    file: Path, old: str, new: str, text: str
) -> None:
    assert old in FILE or old == '"halfway"'
    with pytest.raises(InvalidArgument, match=text) as refused:
        read(
            file, old if old in FILE else 'integrator = "parts:halfway"', new if old in FILE else "steps = 2"
        )
    assert "\n" not in str(refused.value)


def test_what_is_swept_of_a_users_parameter_has_its_unit(file: Path) -> None:
    made = read(file, '"forces.gust.period" = [1, 2]', '"spread.strength" = [1, 2]')
    assert made.axes["spread.strength"].unit == "N"
    assert [each.draws()["strength"].max() for each in made.scenarios] == [1, 2, 1, 2]


def test_a_store_tells_other_code_from_its_own(capsys: pytest.CaptureFixture[str], file: Path) -> None:
    assert swept(capsys, file, "--allow-code")[0] == 0
    (file.parent / "mending.py").write_text(MENDING.replace("0.0, u", "0.5, u"))
    for name in ("parts", "mending"):
        del sys.modules[name]
    code, _, err = swept(capsys, file, "--allow-code")
    assert code == 2
    assert "sweep.zarr" in err


def test_a_users_robot_stands_in_a_file_and_its_keys_are_swept(file: Path) -> None:
    text = '[robot]\ntype = "parts:Puck"\nmass = 3\n[controller]\ntype = "pd"\n[trajectory]\nduration = 6\n'
    made = read_of(
        file, f'{text}[spread]\nmass = {{percent = 10}}\n[ensemble]\nn = 3\n[grid]\n"robot.mass" = [3, 4]'
    )
    assert [each.robot.mass for each in made.scenarios] == [3, 4]
    assert [each.find("mass").value for each in made.scenarios] == [3, 4]
    draws, part = part_of(made.scenarios[1], 0, 3)
    assert all(3.6 <= mass <= 4.4 for mass in draws["mass"])
    assert np.isfinite(part.max_distance).all()


def test_a_module_may_lie_in_a_folder_beside_the_file(file: Path) -> None:
    (file.parent / "laws").mkdir()
    (file.parent / "parts.py").rename(file.parent / "laws" / "parts.py")
    file.write_text(FILE.replace("parts:", "laws.parts:"))
    made: Any = read_grid(file, Code(file.parent)).scenarios[0]
    assert type(made.trajectory).__name__ == "Turning"


def test_a_heading_of_the_library_may_be_a_table(file: Path) -> None:
    text = "[trajectory]\nduration = 6\nheading = {type = 'fixed', psi = 0.5}\n[ensemble]\nn = 3"
    (made,) = read_of(file, text).scenarios
    assert made.reference.q[:, 2].tolist() == [0.5] * 61
    with pytest.raises(InvalidArgument, match=r"^mine.toml:3: unknown key in heading 'phi'"):
        read_of(file, text.replace("psi", "phi"))


PLAIN = """
[controller]
type = "parts:Deadband"
width = 0.01
controller = {type = "parts:PID", kp = 120, kd = 120, ki = 3}
[forces.first]
type = "constant"
force = [1, 0, 0]
[forces.gust]
type = "parts:Gust"
strength = 2
"""


@pytest.mark.parametrize(
    ("old", "new", "at", "text"),
    [
        ("strength = 2", 'strength = "x"', 11, "forces.gust.strength is 'x', expected real numbers"),
        ("strength = 2", "strength = {a = 1}", 11, "forces.gust.strength is {'a': 1}, expected real numbers"),
        ("strength = 2", "strength = [1, 2]", 11, "forces.gust.strength has shape (2,), expected one number"),
        ("[1, 0, 0]", '"x"', 8, "forces.first.force is 'x', expected real numbers"),
        ("[1, 0, 0]", "[1, 2]", 8, "forces.first.force has shape (2,), expected"),
        ("ki = 3", 'ki = "x"', 5, "controller.controller.ki is 'x', expected real numbers"),
        ("ki = 3", "ki = [1, 2]", 5, "controller.controller.ki has shape (2,), expected one number"),
    ],
)
def test_an_argument_of_the_wrong_kind_is_told_with_its_key_and_line(
    file: Path, old: str, new: str, at: int, text: str
) -> None:
    assert PLAIN.count(old) == 1
    with pytest.raises(InvalidArgument) as refused:
        read_of(file, PLAIN.replace(old, new))
    assert str(refused.value).startswith(f"mine.toml:{at}: {text}")
