"""The commands ensemble and sweep, as a person types them."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

from pinmobile import (
    PD,
    Circle,
    CompositePath,
    ComputedTorque,
    InvalidArgument,
    MobileRobot,
    Moved,
    Normal,
    Polyline,
    Same,
    Scenario,
    Sweep,
    Tangent,
    Uniform,
    ensemble,
    plots,
)
from pinmobile.cli.ensembles_and_sweeps import _answer, _differs
from pinmobile.cli.scenario_file import _TABLES, EXAMPLE, read_grid
from pinmobile.loop import COMPILED
from pinmobile.sweeps import length
from tests.damage import answer, damaged, full_disk, little_memory
from tests.test_cli import typed

pytestmark = pytest.mark.once

CIRCLE = Tangent(Circle(3.0, 0.1, 6.0))
SMALL = EXAMPLE.replace("n = 10000", "n = 40").replace("radius = 3", "radius = 3\nduration = 6")


def test_ensemble_compares_both_controllers(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    words = "ensemble --n 40 --duration 6 --spread mass=percent:20 --spread controller.mass=same:mass,1.1"
    code, out, _ = typed(capsys, *words.split(), "--out", str(tmp_path))
    assert code == 0
    assert "with mass=percent:20, PD stays within " in out
    assert "mm in 99 % of runs, computed torque within " in out
    assert "m (controller.mass=same:mass,1.1 for computed torque alone: PD believes in no model)\n" in out
    assert "alike" not in out
    assert f"open {tmp_path / 'index.html'}" in out
    assert "computed torque" in (tmp_path / "index.html").read_text()


def test_ensemble_of_one_controller(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    words = "ensemble --n 40 --duration 6 --controller pd --kp 100,100,0.4 --kd 90,90,0.4 --spread mass=32"
    words += " --after 4"
    code, out, _ = typed(capsys, *words.split(), "--spread", "start.x=normal:0,0.01", "--out", str(tmp_path))
    assert code == 0
    assert "\nfrom t = 4 s on, with mass=32 and start.x=normal:0,0.01, PD stays within " in out
    assert "computed torque" not in out
    assert {file.name for file in tmp_path.glob("*.png")} == {"bands.png", "drivers-pd.png"}
    assert (tmp_path / "index.html").read_text().count("<img") == 2


def test_the_example_names_every_key_of_its_short_tables() -> None:
    sections = dict(re.findall(r"^\[(\w+)\](.*?)(?=^\[|\Z)", EXAMPLE, re.MULTILINE | re.DOTALL))
    assert list(sections) == [*_TABLES, "grid"]
    for table in ("robot", "controller", "loop", "ensemble"):
        assert [key for key in _TABLES[table] if not re.search(rf"\b{key}\b", sections[table])] == []


def test_sweep_runs_the_example_of_its_help(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    (tmp_path / "mass.toml").write_text(SMALL)
    code, out, _ = typed(capsys, "sweep", str(tmp_path / "mass.toml"), "--out", str(tmp_path / "out"))
    assert code == 0
    assert "spread.mass.percent [%]" in out
    # What is left after the start is the mass's: PD's error is of the size of the force over kp, computed
    # torque's of what its model does not know of that force.
    assert "\nfrom t = 5 s on, with spread.mass.percent = 20 %, pd stays within " in out
    assert " mm in 99 % of runs, computed-torque within 1." in out
    assert "in 99 % of runs, computed-torque within " in out
    found = Sweep.open(tmp_path / "out" / "sweep.zarr")
    assert dict(found.dataset.sizes)["spread.mass.percent"] == 3
    assert typed(capsys, "sweep", str(tmp_path / "mass.toml"), "--out", str(tmp_path / "out"))[:2] == (0, out)
    _, shown, _ = typed(capsys, "sweep", "--help")
    assert all(line.split("#")[0].strip() in shown for line in EXAMPLE.splitlines())


FILE = """
[robot]
mass = 20
com = [0.1, -0.5]
[trajectory]
duration = 7
[controller]
model_mass = 25
[spread]
mass = {percent = 10}
"com.y" = {percent = 50}
start.x = {normal = [1, 0.5]}
start.y = {uniform = [2, 3]}
start.psi = [0.1, 0.2]
controller.yaw_inertia = {same = "mass", factor = {uniform = [0.04, 0.06]}}
[ensemble]
n = 2
seed = 3
[grid]
"loop.substeps" = [1, 2]
"controller.type" = ["pd", "computed-torque"]
"""


def test_a_file_is_the_scenarios_that_it_describes(tmp_path: Path) -> None:
    (tmp_path / "file.toml").write_text(FILE)
    made = read_grid(tmp_path / "file.toml")
    assert [(each.substeps, type(each.controller)) for each in made.scenarios] == [
        (substeps, law) for substeps in (1, 2) for law in (PD, ComputedTorque)
    ]
    pd, torque, *_ = made.scenarios
    drawn = {name: source for name, source in torque.spread.items() if name != "start.psi"}
    assert drawn == {
        "mass": Uniform(18, 22),
        "com.y": Uniform(-0.75, -0.25),
        "start.x": Normal(1, 0.5),
        "start.y": Uniform(2, 3),
        "controller.yaw_inertia": Same("mass", Uniform(0.04, 0.06)),
    }
    assert np.asarray(torque.spread["start.psi"]).tolist() == [0.1, 0.2]
    assert set(pd.spread) == {*torque.spread} - {"controller.yaw_inertia"}
    assert torque.controller.robot.mass == 25
    for each in made.scenarios:
        assert (each.n, each.seed, each.dt, each.robot.mass, each.robot.com[:2]) == (
            2,
            3,
            0.1,
            20,
            (0.1, -0.5),
        )


ROUTE = """
[trajectory]
type = "composite"
moved = [1, 2, 0.5]
[[trajectory.paths]]
type = "polyline"
waypoints = [[0, 0], [3, 0]]
duration = 7
acceleration = 0.6
[[trajectory.paths]]
type = "moved"
x = 3
[trajectory.paths.path]
type = "polyline"
waypoints = [[0, 0], [2, 0], [2, 2]]
corner_radius = 0.3
duration = 9
acceleration = 0.6
[loop]
dt = 0.05
[spread]
"trajectory.path.angle" = {normal = [0.5, 0.1]}
[ensemble]
n = 5
"""


def test_a_file_puts_paths_one_after_another_and_anywhere(tmp_path: Path) -> None:
    path = tmp_path / "route.toml"
    path.write_text(ROUTE)
    (scenario,) = read_grid(path).scenarios
    lines = Polyline([(0, 0), (3, 0)], 0.5, 7, 0.6), Polyline([(0, 0), (2, 0), (2, 2)], 0.3, 9, 0.6)
    expected = CompositePath([lines[0], Moved(lines[1], 3)]).moved(1, 2, 0.5)
    assert getattr(scenario.trajectory, "path", None) == expected
    path.write_text(ROUTE.replace("x = 3", "x = 3.5"))
    message = r"^route\.toml:\d+: paths\[1\] starts at \(3\.5, 0\) m, 0\.5 m from \(3, 0\) m, where "
    with pytest.raises(InvalidArgument, match=message):
        read_grid(path)


def test_what_a_file_does_not_say_is_as_the_help_says(tmp_path: Path) -> None:
    (tmp_path / "file.toml").write_text("[ensemble]\nseed = 4\n")
    (one,) = read_grid(tmp_path / "file.toml").scenarios
    assert (one.n, one.seed, one.dt, one.substeps) == (10_000, 4, 0.1, 1)
    (tmp_path / "file.toml").write_text("[ensemble]\nn = 5\n")
    (one,) = read_grid(tmp_path / "file.toml").scenarios
    assert (one.n, one.seed) == (5, 0)


@pytest.mark.parametrize(
    ("name", "unit"),
    [("spread.mass.percent", "%"), ("robot.mass", "kg"), ("spread.com.x", "m"), ("trajectory.rate", "rad/s")],
)
def test_what_is_swept_has_its_unit(tmp_path: Path, name: str, unit: str) -> None:
    (tmp_path / "file.toml").write_text(
        f'[trajectory]\nduration = 6\n[ensemble]\nn = 2\n[grid]\n"{name}" = [1, 2]\n'
    )
    assert read_grid(tmp_path / "file.toml").axes[name].unit == unit


@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        (
            "radius = 3",
            "radus = 3",
            "mass.toml:6: unknown key 'radus' in [trajectory], did you mean 'radius'?\n",
        ),
        (
            "[loop]",
            "[lop]",
            "mass.toml:10: unknown table [lop], did you mean 'loop'? available: loop, ",
        ),
        ("radius = 3", "radius 3", "mass.toml:6: Expected '=' after a key in a key/value pair"),
        ("radius = 3", "radius = -3", "mass.toml:6: radius is -3.0 m, expected > 0"),
        (
            "start.x",
            "start.z",
            "mass.toml:13: unknown parameter in spread 'start.z', did you mean 'start.y' or 'start.x' or ",
        ),
        (
            "normal =",
            "norml =",
            "mass.toml:13: unknown form in the spread of start.x 'norml', did you mean 'normal'",
        ),
        (
            "spread.mass",
            "spread.mas",
            "mass.toml:19: unknown parameter in spread 'mas', did you mean 'mass'",
        ),
        (
            "controller.type",
            "controler.type",
            "mass.toml:20: unknown table 'controler' of 'controler.type' in [grid], did you mean 'control",
        ),
        ("spread.mass.percent", "spread", "mass.toml:19: 'spread' in [grid] is a table, expected one of its"),
        (
            '"circle"',
            '"circel"',
            "mass.toml:5: unknown trajectory 'circel', did you mean 'circle'? ",
        ),
        ('"box"', '"boxx"', "mass.toml:3: unknown robot 'boxx', did you mean 'box'? available: "),
        ('"pd", ', '"pdd", ', "mass.toml:20: unknown controller 'pdd', did you mean 'pd'? available: "),
        (
            'same = "start.x"',
            'same = "start.z"',
            "mass.toml:14: unknown parameter in spread['start.y'] ",
        ),
        ('"circle"', "3", "mass.toml:5: type is 3, expected text in quotes"),
        (
            '["pd", ',
            "[3, ",
            "mass.toml:20: controller.type is [3, 'computed-torque'], expected texts in quotes",
        ),
        ("[5, 10, 20]", "5", "mass.toml:19: spread.mass.percent is 5, expected a list of values"),
        (
            "[5, 10, 20]",
            "[10, 10]",
            "mass.toml:19: spread.mass.percent is [10, 10], expected different numbers or texts",
        ),
        ("[5, 10, 20]", "[5, 200]", "mass.toml:19: spread['mass'] reaches -30 kg"),
        ("n = 40", "n = -1", "mass.toml:16: n is -1, expected a whole number >= 1"),
        ("n = 40", "n = 100000000000", "mass.toml:16: n is 100,000,000,000, expected at most "),
        (
            "radius = 3",
            'heading = "fixed"\nturn_time = 3',
            "mass.toml:7: turn_time does not apply beside heading fixed",
        ),
        ("start.y =", "yaw_inertia =", "mass.toml:14: spread['yaw_inertia'] gives -"),
        (
            'same = "start.x"',
            "same = 3",
            "mass.toml:14: spread of start.y is the same as 3, expected the name",
        ),
        ("[forces]", "model_mass = -1\n[forces]", "mass.toml:9: model_mass is -1.0 kg, expected > 0"),
        ("[forces]", "model_com = [1]\n[forces]", "mass.toml:9: model_com has shape (1,), expected (2,) or"),
        ('"circle"', '"via-free"\nt_via = 90', "mass.toml:7: radius does not apply to the trajectory "),
        (
            "[forces]       ",
            "[forces.wind]\ntype = 'constant'\nforce = [nan, 0, 0]  ",
            "mass.toml:11: forces.wind.force[0] is nan, expected a finite number",
        ),
        ("[0, 0.001]", "[0, -1]", "mass.toml:13: spread of start.x: std is -1.0, expected >= 0"),
    ],
)
def test_a_typo_in_a_scenario_file_is_answered_with_its_line(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, old: str, new: str, text: str
) -> None:
    (tmp_path / "mass.toml").write_text(SMALL.replace(old, new))
    code, _, err = typed(capsys, "sweep", str(tmp_path / "mass.toml"), "--out", str(tmp_path / "out"))
    assert code == 2
    assert text in err
    assert err.count("\n") == 1


def test_an_interrupted_sweep_says_how_to_go_on(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupt(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("pinmobile.cli.ensembles_and_sweeps.run_points", interrupt)
    (tmp_path / "mass.toml").write_text(SMALL)
    code, _, err = typed(capsys, "sweep", str(tmp_path / "mass.toml"), "--out", str(tmp_path / "out"))
    assert (code, err) == (130, "pinmobile: interrupted: the same command goes on where it was\n")


@pytest.mark.parametrize(
    ("words", "text"),
    [
        ("sweep missing.toml", "FILE is 'missing.toml', which cannot be read: No such file or directory"),
        ("sweep tests", "FILE is 'tests', which cannot be read: Is a directory"),
        ("ensemble --spread mass", "--spread is 'mass', expected NAME=FORM with the form uniform:LOW,HIGH"),
        (
            "ensemble --spread mas=1",
            "unknown parameter in spread 'mas', did you mean 'mass'? available: mass, ",
        ),
        (
            "ensemble --spread mass=unifrm:1,2",
            "unknown form in the spread of mass 'unifrm', did you mean 'uniform'? available: uniform",
        ),
        ("ensemble --spread mass=uniform:1", "--spread mass is uniform of 1.0, expected two numbers"),
        (
            "ensemble --spread com.x=percent:5",
            "--spread com.x is 5 percent of 0, expected uniform or normal",
        ),
        ("ensemble --spread mass=normal:1,5", "draws ("),
        ("ensemble --spread mass=uniform:40,20", "--spread mass: low is 40.0, expected at most high, 20.0"),
        ("ensemble --spread mass=normal:0,x", "--spread mass is '0,x', expected a number, or numbers with"),
        ("ensemble --spread mass=12 --spread mass=13", "--spread mass is given 2 times, expected once"),
        (
            "ensemble --controller pd --spread controller.mass=percent:20",
            "unknown parameter in spread 'controller.mass', available: mass, ",
        ),
        ("ensemble --kp 4", "--kp does not apply to both controllers, expected --controller"),
        ("ensemble --gif", "--gif does not apply to ensemble"),
        ("ensemble --n -1", "n is -1, expected a whole number >= 1"),
        ("ensemble --radios 1", "No such option"),
    ],
)
def test_wrong_options_are_answered_in_one_line(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, words: str, text: str
) -> None:
    code, _, err = typed(capsys, *words.split(), "--out", str(tmp_path))
    assert code == 2
    assert text in err
    assert err.count("\n") == 1


def test_robots_that_are_alike_and_a_loop_that_diverges_are_told(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    words = "ensemble --n 30 --duration 6 --controller pd --kd -40 --spread mass=20"
    code, out, _ = typed(capsys, *words.split(), "--out", str(tmp_path))
    assert code == 0
    assert out.startswith("nothing is spread: all robots are alike\n")
    assert "30 robots over 6 s: 30 diverged, all\n" in out
    assert "with mass=20, PD diverges in all runs" in out
    (tmp_path / "one.toml").write_text("[trajectory]\nduration = 6\n[ensemble]\nn = 30\n")
    code, out, _ = typed(capsys, "sweep", str(tmp_path / "one.toml"), "--out", str(tmp_path))
    assert code == 0
    assert out.startswith("nothing is spread: all robots are alike\n")
    assert "\nthe robots stay within " in out


@pytest.mark.parametrize(
    ("source", "differs"),
    [
        (3.0, False),
        (Same("mass"), False),
        (Same("mass", 1.1), False),
        (Same("mass", [1.0, 1.1]), True),
        (Same("mass", Uniform(1, 2)), True),
        ([3.0, 4.0], True),
        (Normal(3, 1), True),
    ],
)
def test_what_is_the_same_for_all_makes_no_robot_differ(source: Any, differs: bool) -> None:
    robot = MobileRobot(30.0, 1.3)
    spread = {"controller.mass": source}
    scenario = Scenario(
        robot=robot, controller=ComputedTorque(robot), trajectory=CIRCLE, n=2, dt=0.1, spread=spread
    )
    assert _differs(scenario.spread["controller.mass"]) == differs


def test_the_answer_of_an_ensemble_is_that_of_99_percent() -> None:
    robot = MobileRobot(30.0, 1.3)
    spread: Any = {"mass": Uniform(24, 36)}
    made = ensemble(
        robot, PD((120, 120, 5), (120, 120, 5)), CIRCLE, n=50, dt=0.1, spread=spread, engine=COMPILED
    )
    within = [length(made.within(share).distance) for share in (0.99, 0.5)]
    assert within[0] != within[1]
    assert _answer({"PD": made}, ["mass=percent:20"]) == (
        f"with mass=percent:20, PD stays within {within[0]} in 99 % of runs"
    )


def test_a_store_keeps_its_chunk(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    (tmp_path / "mass.toml").write_text(SMALL)
    words = "sweep", str(tmp_path / "mass.toml"), "--out", str(tmp_path), "--chunk"
    assert typed(capsys, *words, "20")[0] == 0
    code, _, err = typed(capsys, *words, "30")
    assert code == 2
    assert "chunk is 30, expected 20 as in the store" in err


def test_a_file_that_never_ends_is_answered(capsys: pytest.CaptureFixture[str]) -> None:
    with little_memory():
        code, _, err = typed(capsys, "sweep", "/dev/zero")
    assert code == 2
    assert err.endswith("zero has more than 8 MiB, expected less\n")


def test_a_file_that_is_no_text_is_answered(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    (tmp_path / "mass.toml").write_bytes(b"[robot]\nbase = '\xff'\n")
    code, _, err = typed(capsys, "sweep", str(tmp_path / "mass.toml"))
    assert code == 2
    assert err.endswith("which cannot be read: byte 16 is not UTF-8\n")


def test_two_swept_numbers_are_drawn_as_maps_one_for_each_controller(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn: list[Any] = []
    numbers: list[Any] = []
    scales: list[Any] = []

    def heatmap(values: Any, *, x: Any, y: Any, label: str, title: str, limits: Any) -> Figure:
        drawn.append((values.shape, x[:2], list(x[2]), y[:2], list(y[2]), label, title))
        numbers.append(values)
        scales.append(limits)
        return Figure()

    monkeypatch.setattr(plots, "heatmap", heatmap)
    file = tmp_path / "two.toml"
    file.write_text(SMALL + '"trajectory.rate" = [0.05, 0.1]\n')
    code, _, _ = typed(capsys, "sweep", str(file), "--out", str(tmp_path))
    assert code == 0
    axes = ("trajectory.rate", "rad/s"), [0.05, 0.1], ("spread.mass.percent", "%"), [5, 10, 20]
    assert [one[:-1] for one in drawn] == [((3, 2), *axes, "99 % stay within [mm]")] * 2
    assert [one[-1] for one in drawn] == ["pd", "computed-torque"]
    assert (tmp_path / "index.html").read_text().count("<img") == 2
    assert numbers[0].max() != numbers[1].max()
    assert scales == [(np.min(numbers), np.max(numbers))] * 2  # one scale of colours for both


def test_one_swept_number_is_drawn_as_a_curve_for_each_controller(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn: list[Any] = []

    def curves(values: Any, *, x: Any, label: str, title: str | None) -> Figure:
        drawn.append((list(values), [len(row) for row in values.values()], x, label, title))
        return Figure()

    monkeypatch.setattr(plots, "curves", curves)
    (tmp_path / "mass.toml").write_text(SMALL)
    assert typed(capsys, "sweep", str(tmp_path / "mass.toml"), "--out", str(tmp_path))[0] == 0
    x = "spread.mass.percent", "%", [5, 10, 20]
    assert drawn == [(["pd", "computed-torque"], [3, 3], x, "99 % stay within [mm]", None)]
    assert "within-0.png" in (tmp_path / "index.html").read_text()


def test_two_swept_names_are_drawn_as_a_map(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    text = SMALL.replace('"spread.mass.percent" = [5, 10, 20]', '"robot.base" = ["box", "lecture"]')
    (tmp_path / "names.toml").write_text(text)
    assert typed(capsys, "sweep", str(tmp_path / "names.toml"), "--out", str(tmp_path))[0] == 0
    assert (tmp_path / "within-0.png").exists()


@pytest.mark.parametrize("command", ["ensemble", "sweep"])
def test_the_help_lists_what_may_be_spread(capsys: pytest.CaptureFixture[str], command: str) -> None:
    _, shown, _ = typed(capsys, command, "--help")
    words = " ".join(shown.split())
    assert "plant: mass (kg), yaw_inertia (kg m^2), com (m), com.x (m)" in words
    assert "start_rate.vx (m/s), start_rate.vy (m/s), start_rate.yaw_rate (rad/s)" in words


def test_a_full_disk_in_a_sweep_is_told_and_it_goes_on(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    (tmp_path / "mass.toml").write_text(SMALL)
    words = "sweep", str(tmp_path / "mass.toml"), "--out", str(tmp_path / "out")
    with full_disk(9000):
        code, _, err = typed(capsys, *words)
    assert code == 1
    file = r"pinmobile: a file of the store is '.*sweep\.zarr/.*', which cannot be written: File too large; "
    assert re.fullmatch(file + "what is done is in the store: start the same sweep again to resume\n", err)
    code, out, _ = typed(capsys, *words)
    assert code == 0
    assert " mm in 99 % of runs, computed-torque within 1." in out


ODD = [
    "nan",
    "inf",
    "-1",
    "0",
    "-1e308",
    "1e-300",
    "10000000000000000000000",
    "true",
    '""',
    '"x"',
    "[]",
    "[1]",
    "[1,2,3,4]",
    "[nan,1]",
    '["a"]',
    "[[1]]",
    "{}",
    "{a=1}",
    "2020-01-01",
    "12:00:00",
    "{uniform=[1]}",
    "{uniform=[2,1]}",
    "{uniform=[nan,1]}",
    "{normal=[0,inf]}",
    "{percent=nan}",
    "{percent=true}",
    "{same=3}",
    "{same=[]}",
    '{same="mass",factor=[1]}',
    "{uniform=[1,2],normal=[1,2]}",
    "{factor=2}",
    '{uniform="ab"}',
    "{percent=[1]}",
    '{uniform=[true,"x"]}',
    "{uniform=[{},[]]}",
]


@pytest.mark.filterwarnings("ignore::RuntimeWarning")  # numpy's, of sizes beyond all that exist
def test_odd_values_in_a_scenario_file_are_a_grid_or_refused_by_its_name(tmp_path: Path) -> None:
    path, rng = tmp_path / "file.toml", np.random.default_rng(0)
    keys = [(table, key) for table, names in _TABLES.items() for key in names]
    for _ in range(500):
        (table, key), value = keys[rng.integers(len(keys))], ODD[rng.integers(len(ODD))]
        tables: dict[str, dict[str, str]] = {"trajectory": {"duration": "6"}, "ensemble": {"n": "3"}}
        if rng.integers(2):
            tables["grid"] = {f'"{table}.{key}"': f"[{value}]"}
        else:
            tables.setdefault(table, {})[key] = value
        rows = []
        for name, content in tables.items():
            rows += [f"[{name}]", *(f"{name} = {given}" for name, given in content.items())]
        path.write_text("\n".join(rows))
        found = answer(lambda: read_grid(path))
        if isinstance(found, Exception):
            assert "file.toml" in str(found), (table, key, value, found)


@pytest.mark.filterwarnings("ignore::RuntimeWarning")  # numpy's, of sizes beyond all that exist
def test_a_damaged_scenario_file_is_a_grid_or_refused_by_its_name(tmp_path: Path, share: int) -> None:
    content, path = SMALL.replace("n = 40", "n = 4").encode(), tmp_path / "file.toml"
    lines = content.splitlines(keepends=True)
    words = [
        b"[",
        b"]",
        b"{",
        b"}",
        b"=",
        b"nan",
        b"inf",
        b"-1",
        b"0",
        b"1e300",
        b"true",
        b'"',
        b"'pd'",
        b"[[]]",
    ]
    words += [b"2020-01-01", b"{}", b"[]", b"\xff", b"\0", b"a.b.c = 1\n", b"[robot.mass]\n", b"0x7fffffff"]
    made, refused = 0, 0
    for seed in range(0, 240, share):
        rng = np.random.default_rng(seed)
        kind, given = rng.integers(4), list(lines)
        if kind == 0:
            mutant = damaged(content, rng)
        elif kind == 1:
            i, j = rng.integers(len(lines), size=2)
            given[i] = given[j]
            mutant = b"".join(given)
        elif kind == 2:
            values = re.split(rb"(?<=[=,\[ ])(?=[^\s])", content)
            place = int(rng.integers(len(values)))
            rest = re.sub(rb"^[^\s,\]}#]+", b"", values[place])
            values[place] = words[int(rng.integers(len(words)))] + rest
            mutant = b"".join(values)
        else:
            place = int(rng.integers(len(content)))
            mutant = content[:place] + words[int(rng.integers(len(words)))] + content[place:]
        path.write_bytes(mutant)
        found = answer(lambda: read_grid(path))
        if isinstance(found, Exception):
            assert "file.toml" in str(found), (seed, mutant, found)
            refused += 1
        else:
            made += 1
            assert found.n * len(found.scenarios) < 1e6
    assert min(made, refused) > 30 / share
