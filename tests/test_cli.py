"""The command as a person types it."""

import os
import re
import shlex
import signal
import subprocess
import sys
from collections.abc import Callable
from html import unescape
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest
import typer
from matplotlib.figure import Figure

import pinmobile as pm
from pinmobile import plots
from pinmobile.cli import main, verbs
from pinmobile.cli.lecture import EXPECTED
from pinmobile.cli.results import IdentifyPaths
from pinmobile.cli.verbs import TASKS, app, complete
from pinmobile.errors import SchedulerError
from pinmobile.parts import parameters
from tests.chromium import Chromium
from tests.damage import full_disk
from tests.test_identification import HEAD, log, rolled
from tests.test_velocity_identification import logged
from tests.webclient import eventually

SLIDE = """<robot name="slide"><link name="foot"/><link name="slider"><inertial><mass value="2"/>
  <inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="lift" type="prismatic"><parent link="foot"/><child link="slider"/><axis xyz="0 0 1"/>
  <limit lower="-0.04" upper="0.01" effort="30" velocity="2"/></joint></robot>"""
SHORT = ["trajectory.path.duration=6", "n=40"]


Typed = Callable[..., tuple[int, str, str]]


@pytest.fixture
def typed(capsys: pytest.CaptureFixture[str]) -> Typed:
    """Return what runs words and returns the exit code and what was printed, without the page of an error."""

    def run(*words: str) -> tuple[int, str, str]:
        code, (out, err) = main(words), capsys.readouterr()
        return code, out, re.sub(r"pinmobile: page of the documentation: [a-z/-]+\n$", "", err)

    return run


@pytest.mark.parametrize(
    ("words", "page"),
    [("run dt=0", "howto/scenario-files"), ("identify", "howto/identify"), ("sweeep", "howto/headless")],
)
def test_an_error_names_its_page(capsys: pytest.CaptureFixture[str], words: str, page: str) -> None:
    assert main(words.split()) == 2
    assert capsys.readouterr().err.endswith(f"\npinmobile: page of the documentation: {page}\n")
    assert {verb for verbs in TASKS.values() for verb in verbs} == {*typer.main.get_command(app).commands}  # type: ignore[attr-defined]
    pages = {page for verbs in TASKS.values() for page in verbs.values()} - {"reference/derivation"}
    site = Path(__file__).parents[1] / "docs" / "site"
    assert all((site / f"{page}.md").exists() for page in pages)


@pytest.mark.long
@pytest.mark.once
def test_lecture_prints_its_numbers_and_what_wheels_change_and_draws_them(
    typed: Typed, tmp_path: Path
) -> None:
    folder = tmp_path / "out"
    code, text, _ = typed("lecture", "--out", str(folder))
    assert code == 0
    for (trajectory, controller), (x, y) in EXPECTED.items():
        assert re.search(rf"{trajectory} +{controller} +{x} +{x} +{y} +{y}\n", text)
    assert "all twelve numbers are the lecture's, to every digit" in text
    assert "the methods agree" in text
    assert "M[psi, psi] = Icz + m*(xbc**2 + ybc**2)" in text
    assert all(len(line) <= 80 for line in text.splitlines() if "/" not in line)
    shown = text.split("4  On wheels")[1]
    pattern = r"^(via stop|via free|circle) +(PD|computed torque\*)((?: +\S+){4})$"
    rows = re.findall(pattern, shown, re.MULTILINE)
    found = {(path, controller): [float(x) for x in numbers.split()] for path, controller, numbers in rows}
    assert len(found) == 6
    for (path, controller), (free, back, driven, left) in found.items():
        assert back == free, "the free body slides back to its path"
        if controller == "PD":
            assert left > 5 * driven, "wheels do not push sideways"
            assert driven < (free / 20 if path == "circle" else 2 * free)
        else:
            assert max(driven, left) < 1e-4
    assert "a jump of its heading by 0.785 rad at t = 0.1 s" in shown
    page, names = (folder / "index.html").read_text(), ("via-stop", "via-free", "circle")
    kinds = ("animation.gif", "path.png", "states.png", "errors.png", "forces.png")
    figures = {f"{name}-{kind}" for name in names for kind in kinds}
    others = {"derivation.txt", "index.html", "wheels.png"}
    assert {path.name for path in folder.iterdir()} == figures | {f"{name}.html" for name in names} | others
    for name in (f"{each}.html" for each in names):
        assert f'<a href="{name}">' in page
    assert text.endswith(f"see it move: open {folder / 'circle.html'}\n")
    for name in (*figures, "wheels.png"):
        assert re.search(rf'<img src="{name}" alt="[^"]+"', page)
        assert 1_000 < (folder / name).stat().st_size < 1_000_000
    assert "http" not in page
    assert f"open {folder / 'index.html'}" in text
    assert "force" in (folder / "derivation.txt").read_text()


@pytest.mark.once
@pytest.mark.long
def test_lecture_says_no_when_a_number_is_not_the_lectures(
    typed: Typed, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(EXPECTED, ("circle", "PD"), ("7.481304e-03", "7.481287e-03"))
    monkeypatch.setattr("pinmobile.cli.lecture.draw", lambda *_: [])
    code, out, _ = typed("lecture", "--no-gif", "--out", str(tmp_path))
    assert code == 1
    assert "some numbers are NOT the lecture's: see the rows marked DIFFERS" in out
    assert out.count("  DIFFERS\n") == 1


def test_verify_and_derive_take_robots(typed: Typed, tmp_path: Path) -> None:
    path = tmp_path / "mine.urdf"
    path.write_text(pm.MobileRobot(7, 0.5, com=(0.1, 0)).to_urdf())
    slides = "robot=MobileRobot(10, 1.2, (0.1, 0.05), dh=SLIDE_TABLE)"
    for word in (slides, f"robot=MobileRobot.from_urdf({str(path)!r}, ground=-0.1)", "ur5", "mecanum"):
        code, out, _ = typed("verify", word, "--states", "3")
        assert (code, "all methods agree" in out) == (0, True)
    for words, text in (([], "Mass matrix"), (["car"], "n_nu ="), (["mecanum"], "Null space")):
        code, out, _ = typed("derive", *words)
        assert (code, text in out) == (0, True)
        assert "\\frac" in typed("derive", *words, "--latex")[1] or not words
    code, _, err = typed("derive", "swerve")
    assert (code, err[:45]) == (2, "pinmobile: robot has wheels of type (1, 2), e")


def test_run_is_the_lectures_circle_by_default_and_tells_its_progress_where_no_terminal_is(
    typed: Typed, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "a" / "b"
    monkeypatch.setattr("pinmobile.cli.output._MINUTE", 0.02)
    code, text, err = typed("run", "--out", str(out), "--film", str(tmp_path / "a" / "see.html"))
    assert code == 0
    assert any(line.startswith("drawing ") for line in err.splitlines())
    assert all(re.fullmatch(r"[a-z ]+: \d+ of \d+, \d+ s", line) for line in err.splitlines())
    assert "drawing" not in text
    assert "largest error: x 3.491279e-05 m, y 3.491278e-05 m" in text
    assert f"open {out / 'index.html'}\nsee it move: open {tmp_path / 'a' / 'see.html'}\n" in text
    assert (tmp_path / "a" / "see.html").stat().st_size > 100_000
    rollout = pm.Rollout.load(out / "rollout.npz")
    assert rollout.max_error()[0] == pytest.approx(3.491279e-05, rel=1e-6)
    assert (out / "rollout.csv").read_text().startswith("t [s],x [m],y [m],psi [rad]")
    names = {path.name for path in out.iterdir()}
    assert names == {"rollout.npz", "rollout.csv", "index.html", *(f"{each}.png" for each in FIGURES)}
    page, scenario = unescape((out / "index.html").read_text()), typed("write")[1]
    releases = rf"# python \S+, pinmobile {re.escape(pm.__version__)}, .*pin \S+.*\n"
    assert re.search(rf"<h2>Scenario</h2>\n<pre>{releases}{re.escape(scenario)}</pre>", page)


@pytest.mark.parametrize(
    ("verb", "text", "words", "message"),
    [
        ("run", "dt = 0.1\nduration = 500\n", "", r"scenario\.toml:2: duration is 500\.0 s, expected"),
        ("run", "dt = 0.1\n", "duration=500", r"duration=500: duration is 500\.0 s"),
        ("ensemble", "\n\nafter = 500\n", "n=5", r"scenario\.toml:3: after is 500\.0 s"),
    ],
)
def test_what_does_not_fit_to_another_entry_has_its_line(
    verb: str, text: str, words: str, message: str, typed: Typed, tmp_path: Path
) -> None:
    file = tmp_path / "scenario.toml"
    file.write_text(text, encoding="utf-8-sig")  # as editors on Windows do
    code, _, err = typed(verb, str(file), *words.split(), "--out", str(tmp_path))
    assert code == 2
    assert re.search(message, err)


@pytest.mark.once
@pytest.mark.long
def test_a_signal_of_a_batch_system_leaves_no_temporary_files(tmp_path: Path, browser: Chromium) -> None:
    film, out = tmp_path / "a.mp4", tmp_path / "out"
    words = sys.executable, "-m", "pinmobile", "run", "--film", str(film), "--out", str(out)
    with TemporaryDirectory() as name:  # a short path: Chromium opens a socket in it
        folder, streams = Path(name), {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT}
        environment = {**os.environ, "TMPDIR": name}
        process = subprocess.Popen(words, env=environment, text=True, **streams)  # type: ignore[call-overload]
        assert eventually(lambda: any(folder.glob("*/film.mp4")))
        process.send_signal(signal.SIGTERM)
        text, _ = process.communicate(timeout=60)
        assert (process.returncode, text.splitlines()[-1]) == (130, "pinmobile: interrupted")
        assert not [*folder.iterdir()]
    assert not film.exists()


FIGURES = "path", "states", "errors", "forces", "balance"


def test_run_draws_what_wheels_do_and_prints_metrics(typed: Typed, tmp_path: Path) -> None:
    words = "skid-steer", "duration=0.1", "controller.robot.robot.mass=40", "--film", str(tmp_path / "a.gif")
    code, out, _ = typed("run", *words, "--out", str(tmp_path))
    assert code == 0
    assert re.search(r"^smallest load \[N\]: \d+", out, re.MULTILINE)
    assert re.search(r"^largest slip \[m/s\]: 0\.\d+", out, re.MULTILINE)
    assert re.match(r"robot: WheeledRobot\(MobileRobot\(mass=30\.0, .* \.\.\.\n", out)
    assert "\ntip over: no\n" in out
    names = {path.name for path in tmp_path.iterdir()}
    assert {"a.gif", "wheel_torques.png", "friction.png", "slip.png", "loads.png"} < names


def test_a_run_that_diverges_keeps_what_came_before(typed: Typed, tmp_path: Path) -> None:
    words = "controller=PD((120, 120, 0.4), (120, 120, 0.4))", "robot.com=[0.1, 0.05]"
    code, out, err = typed("run", *words, "--out", str(tmp_path))
    assert code == 1
    assert err.startswith("pinmobile: the loop diverged at t = ")
    assert err.count("\n") == 1
    assert "up to there:" in out
    assert len(pm.Rollout.load(tmp_path / "rollout.npz")) > 3


@pytest.mark.parametrize(
    ("words", "text"),
    [
        ("run controller.kp=4,a controller.kd=b", "pinmobile: controller.kd=b: controller.kd is 'b', "),
        ("run --film a.avi", "--film is 'a.avi', expected a name that ends in '.html' or '.gif' or "),
        ("view a.npz ur5", "'ur5' is beside saved rollouts, expected .npz files only"),
        ("view run.csv", "FILE is 'run.csv', a recorded run, expected a scenario; view takes .npz of runs"),
        ("run differential robot.mass=25", "robot.mass is unknown, WheeledRobot has robot, table, ground"),
        ("ensemble spread.mass=Normal(1,5)", "draws ("),
        ("play --out run.csv", "--out is 'run.csv', expected a name that ends in '.npz'"),
        ("export controller=MPC dt=0.05 trajectory.path.duration=5", "controller cannot be exported: MPC"),
        ("parts pd", "NAME is 'pd', expected a part, did you mean 'PD'?"),
    ],
)
def test_wrong_words_are_answered_in_a_line_each(typed: Typed, tmp_path: Path, words: str, text: str) -> None:
    out = ["--out", str(tmp_path)] if words.split()[0] in ("run", "ensemble", "export") else []
    code, _, err = typed(*words.split(), *out)
    assert (code, text in err) == (2, True), err
    assert all(line.startswith("pinmobile: ") for line in err.splitlines())
    assert err.count("\n") == 1 + ("kd=b" in words)


def test_an_output_folder_that_is_a_file_is_refused_before_any_work(typed: Typed, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    code, _, err = typed("run", "--out", "run.npz")
    assert (code, err) == (2, "pinmobile: --out is 'run.npz', expected a folder, such as run\n")
    code, out, err = typed("run", "--out", str(tmp_path / "file" / "out"))
    assert code == 2
    assert "which cannot be written to" in err
    assert out == ""


def test_help_teaches_and_loads_no_library(typed: Typed) -> None:
    for words in ([], ["--help"]):
        code, out, _ = typed(*words)
        assert code == 0
        assert "pinmobile write > mine.toml" in " ".join(out.split())
        for verb in [name for task in TASKS.values() for name in task]:
            assert f"\n  {verb} " in out
            assert "Example: pinmobile " in typed(verb, "--help")[1] or verb == "lecture"
    assert typed("--version")[:2] == (0, f"pinmobile {pm.__version__}\n")
    assert "Folder of records and figures;" in " ".join(typed("run", "--help")[1].split())
    assert "Folder of the C files;" in " ".join(typed("export", "--help")[1].split())
    text = "import sys; from pinmobile.cli import main; main(['run', '--help']); print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", text], capture_output=True, text=True, check=True)
    assert not {"numpy", "pinocchio"} & set(done.stdout.split())


def test_parts_are_listed_from_their_declarations(typed: Typed) -> None:
    for words, text in (
        ([], "\n  ComputedTorque       Computed torque, tau = M(q)"),
        (["Circle"], "radius           radius of the circle; a number > 0 [m]\n"),
        (["WheelTable.differential"], "track            Distance between the wheels, > 0 [m]\n"),
        (["WheelTable.differential"], "**               Other parameters of each `wheels.Wheel`: ``mass``"),
        (["scenario"], "dt               time step; a number > 0 [s]; default 0.1\n"),
        (["MobileRobot"], "MobileRobot.from_urdf, "),
        (["--schema"], '"exclusiveMinimum": 0.0'),
    ):
        code, out, _ = typed("parts", *words)
        assert (code, text in out) == (0, True), words


def test_write_prints_a_file_to_begin_with(typed: Typed, tmp_path: Path) -> None:
    code, text, _ = typed("write", "lecture", "controller.kp=9")
    assert code == 0
    meaning = "proportional gain: a number, or numbers of shape (n,) or (n, n) >= 0 [1/s^2]"
    assert f"\nkp = 9.0  # {meaning}\n" in text
    (tmp_path / "mine.toml").write_text(text)
    assert typed("write", str(tmp_path / "mine.toml")) == (0, text, "")


def test_words_are_completed() -> None:
    assert complete("con") == ["controller=", "controller."]
    assert complete("trajectory.path.ra") == ["trajectory.path.radius=", "trajectory.path.rate="]
    assert complete("mec") == ["mecanum"]


def test_films_are_refused_before_anything_runs_and_told_frame_by_frame(
    typed: Typed, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    pytest.importorskip("imageio_ffmpeg", reason="needs the extra mp4")

    def save(recording: Any, path: Path, *, progress: Any) -> None:
        assert recording.duration / recording.speed == pytest.approx(10)  # a minute in ten seconds
        progress(1, 2)
        path.write_bytes(b"film")

    words = "run", "--film", str(tmp_path / "film.mp4"), "--out", str(tmp_path)
    monkeypatch.setattr("pinmobile.viewer.Recording.save_mp4", save)
    monkeypatch.setenv("PINMOBILE_CHROMIUM", sys.executable)  # any program: none is started
    assert typed(*words)[0] == 0
    assert (tmp_path / "film.mp4").read_bytes() == b"film"
    monkeypatch.setenv("PINMOBILE_CHROMIUM", "no-such-program")
    monkeypatch.setattr("pinmobile.cli.results.LoadedFile", None)
    code, _, err = typed(*words)
    assert (code, err) == (2, "pinmobile: PINMOBILE_CHROMIUM is 'no-such-program', expected a program\n")


def test_an_ensemble_is_printed_and_drawn(typed: Typed, tmp_path: Path) -> None:
    words = ["ensemble", "spread.robot.mass=Relative(Uniform(0.8, 1.2))", "spread.start.x=Normal(0, 0.01)"]
    code, out, err = typed(*words, *SHORT, "after=4", "--out", str(tmp_path))
    assert (code, err) == (0, "")
    assert "40 robots over 6 s: from 4 s on 99 % stay within " in out
    assert {path.name for path in tmp_path.iterdir()} == {"index.html", "bands.png", "drivers.png"}
    assert "all robots are equal" in typed("ensemble", *SHORT, "--out", str(tmp_path))[1]


SWEPT = """
n = 40
after = 5
trajectory = "Tangent(Circle(3, 0.1, 6))"
[spread]
robot.mass = "Relative(Uniform(0.8, 1.2))"
[grid]
robot.com.x = [0.0, 0.01, 0.02]
controller.PD = "PD(kp=(120, 120, 0.4), kd=(120, 120, 0.4))"
controller."computed torque" = "ComputedTorque"
"""


@pytest.fixture
def swept(tmp_path: Path) -> list[str]:
    (tmp_path / "mass.toml").write_text(SWEPT)
    return ["sweep", str(tmp_path / "mass.toml"), "--out", str(tmp_path / "out")]


def test_a_sweep_is_printed_drawn_and_kept(
    typed: Typed, swept: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn: list[Any] = []

    def curves(values: Any, *, x: Any, label: str, title: str | None) -> Figure:
        drawn.append((list(values), [len(row) for row in values.values()], x, label, title))
        return Figure()

    monkeypatch.setattr(plots, "curves", curves)
    code, out, _ = typed(*swept)
    assert code == 0
    assert "robot.com.x [m]" in out
    assert "PD stays within " in out
    assert dict(pm.Sweep.open(tmp_path / "out" / "sweep.zarr").dataset.sizes)["robot.com.x"] == 3
    assert drawn[0][:2] == (["PD", "computed torque"], [3, 3])
    assert drawn[0][2] == ("robot.com.x", "m", [0.0, 0.01, 0.02])
    code, again, _ = typed(*swept)
    assert code == 0
    words = r"\S+sweep\.zarr exists: if it is of this sweep, only what it lacks is run\n"
    assert re.fullmatch(words, again.removesuffix(out))


def test_a_sweep_of_two_numbers_is_drawn_as_maps(typed: Typed, swept: list[str], tmp_path: Path) -> None:
    assert typed(*swept, "n=5", "grid.trajectory.path.rate=[0.05, 0.1]")[0] == 0
    assert (tmp_path / "out" / "index.html").read_text().count("<img") == 2


def test_a_sweep_says_how_to_go_on(typed: Typed, swept: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupt(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("pinmobile.cli.results.run_points", interrupt)
    code, _, err = typed(*swept)
    assert (code, err) == (130, "pinmobile: interrupted: repeat the command to resume\n")


@pytest.mark.parametrize(
    ("words", "file"),
    [
        ("run dt=0.5 --out OUT", "rollout.npz"),
        ("ensemble n=20 trajectory.path.duration=6 spread.mass=Uniform(20,40) --out OUT", "bands.png"),
    ],
)
def test_a_full_disk_is_told_in_one_line_that_names_the_file(
    typed: Typed, tmp_path: Path, words: str, file: str
) -> None:
    (tmp_path / file).write_bytes(b"good")
    with full_disk(5000):
        code, _, err = typed(*words.replace("OUT", str(tmp_path)).split())
    assert code == 1
    assert err == (f"pinmobile: path is {str(tmp_path / file)!r}, which cannot be written: File too large\n")
    assert [(each.name, each.read_bytes()) for each in tmp_path.iterdir()] == [(file, b"good")]


REFUSED = "pinmobile: duration=0: duration is 0, expected .*\npinmobile: page of the .*"


@pytest.mark.parametrize(
    ("closed", "options", "code", "text"),
    [(">&-", "duration=0", 2, REFUSED), (">&- 2>&-", "duration=1", 0, "")],
)
def test_closed_output_is_no_output(closed: str, options: str, code: int, text: str, tmp_path: Path) -> None:
    words = f"exec {shlex.quote(sys.executable)} -m pinmobile write {options} {closed}"
    done = subprocess.run(["sh", "-c", words], capture_output=True, text=True, timeout=100, cwd=tmp_path)
    assert done.returncode == code
    assert re.fullmatch(text, (done.stdout + done.stderr).strip()), done


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="Linux alone has a device that is full")
def test_a_console_behind_which_the_disk_is_full_is_told_in_one_line() -> None:
    words = [sys.executable, "-m", "pinmobile", "parts"]
    with Path("/dev/full").open("wb") as full:
        done = subprocess.run(words, stdout=full, stderr=subprocess.PIPE, check=False, timeout=100)
    assert done.returncode == 1
    assert done.stderr == b"pinmobile: the output cannot be written: [Errno 28] No space left on device\n"


def test_view_says_why_it_does_not_know_the_robot_of_a_file(typed: Typed, tmp_path: Path) -> None:
    urdf, file = tmp_path / "slide.urdf", tmp_path / "run.npz"
    urdf.write_text(SLIDE)
    robot = pm.MobileRobot.box().mount(urdf)
    motion = pm.WholeBody(robot, pm.FixedHeading(pm.Circle(1, 0.1, 1), 0), None)
    pm.simulate(robot, pm.ComputedTorque(robot), motion, dt=0.5).save(file)
    urdf.unlink()
    code, out, err = typed("view", str(file))
    assert (code, out) == (2, "")
    said = "has no robot: arm is '.*slide.urdf', which cannot be read"
    assert re.search(rf"^pinmobile: '.*run.npz' {said}", err)


# -- logs ------------------------------------------------------------------------------------------


def rows(read: Any = None) -> Any:
    read = log() if read is None else read
    return np.column_stack([read.t, read.q, read.u])


def written(path: Path, table: Any, head: str = HEAD) -> str:
    np.savetxt(path, table, "%.9g", ",", header=head, comments="")
    return str(path)


def estimate(name: str, told: str) -> float:
    return float(re.findall(rf"^{name} +(\S+) ", told, re.MULTILINE)[0])


@pytest.mark.once
def test_identify_prints_the_table_and_draws_the_prediction(typed: Typed, tmp_path: Path) -> None:
    table, out = rows(), tmp_path / "figures"
    logs = [written(tmp_path / f"{k}.csv", each) for k, each in enumerate((table[:700], table[760:]))]
    words = [*logs, "robot=MobileRobot(30, 1.5)", "method=weak", "delay=0", "--out", str(out)]
    code, told, err = typed("identify", *words)
    assert (code, err) == (0, "")
    assert estimate("mass", told) == pytest.approx(32, abs=1)
    assert "2141 samples at 50 Hz, 0 dropped" in told
    assert told.endswith(f"measured and predicted: open {out / '1.png'}\n")  # of the longest
    assert (out / "1.png").stat().st_size > 20_000


def test_identify_takes_commands_and_columns_of_other_names(typed: Typed, tmp_path: Path) -> None:
    path = written(tmp_path / "run.csv", rows(logged(pose=True)), "stamp,px,py,angle [rad],v,w")
    words = "identify", path, "columns.q=px,py,angle", "columns.u=v,w", "--out", str(tmp_path)
    code, told, _ = typed(*words)
    assert code == 0
    assert re.search(r"^theta_6 +1\.0\d+", told, re.MULTILINE)
    for word in ("rolling_speed=0.1", "rolling_speed=0.0", "method=weak"):
        code, _, err = typed(*words, word)
        name, _, value = word.partition("=")
        given = repr(value) if name == "method" else value
        said = f"{name} is {given}, expected None for a log of commands of speed and yaw rate"
        assert (code, err) == (2, f"pinmobile: {said}\n")


def reverse(table: Any) -> Any:
    table[:, 4:] = table[::-1, 4:]
    return table


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (reverse, r"log has inputs that explain .*another robot.*"),
        (
            lambda table: table[np.r_[:300, 200:2101]],
            r"t\[300\] is 4\.0\d* s after 5\.98\d* s, expected more: sort the rows by time, or split the .*",
        ),
    ],
)
def test_a_bad_log_is_answered_in_one_line(
    change: Callable[[Any], Any], text: str, typed: Typed, tmp_path: Path
) -> None:
    path = written(tmp_path / "run.csv", change(rows()))
    code, told, err = typed("identify", path, "--out", str(tmp_path))
    assert (code, told.strip()) == (2, "")
    assert re.fullmatch(rf"pinmobile: LOG is '\S+run\.csv': {text}\n", err), err


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("none.csv", r"LOG is '\S+none\.csv', which cannot be read: No such file or directory"),
        ("run.csv columns=3", "columns=3: columns is 3, expected columns.ROLE=NAME,NAME, such as .*"),
        ("run.csv colums.q=x,y,psi", r"\S+: colums is unknown, available: robot, .*did you mean 'columns'\?"),
        (
            "run.csv topics.q=/odom",
            "topics is .*, expected topics of u and of q, twist, wheel_rates or joi.*",
        ),
        ("robot=3", "LOG is missing, expected at least one file, such as run.csv"),
        ("run.csv loads=2", "loads is 2, expected one for each log: .*"),
        ("run.csv columns.u=1.5", r"columns\.u=1\.5: columns is 1\.5, expected NAME or NAME,NAME"),
    ],
)
def test_words_about_no_log_have_one_answer(words: str, message: str, typed: Typed, tmp_path: Path) -> None:
    written(tmp_path / "run.csv", rows())
    told = [str(tmp_path / word) if word.endswith(".csv") else word for word in words.split()]
    code, _, err = typed("identify", *told, "--out", str(tmp_path))
    assert code == 2
    assert re.fullmatch(f"pinmobile: ({message})\n", err), err


def test_the_help_of_identify_names_every_path() -> None:
    words = " ".join((verbs.identify.__doc__ or "").split())
    for name in parameters(IdentifyPaths):
        assert re.search(rf"Paths: .*\b{name}\b", words), name


def test_a_lost_cluster_is_a_failure(typed: Typed, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def lost(address: str) -> None:
        raise SchedulerError(f"scheduler is {address!r}, which does not answer")

    monkeypatch.setattr("pinmobile.cli.results.connect", lost)
    code, _, told = typed("sweep", "rivals", f"--out={tmp_path}", "--scheduler=tcp://127.0.0.1:1")
    assert (code, told) == (1, "pinmobile: scheduler is 'tcp://127.0.0.1:1', which does not answer\n")


def test_one_path_of_an_arm_needs_no_list(typed: Typed) -> None:
    arm = "Hold([0, 0, 0, 0, 0, 0], 1)"
    motion = f"WholeBody(MobileRobot.box().mount('ur5'), Tangent(Circle(1, 0.5, 1)), {arm})"
    code, said, _ = typed("write", "ur5", f"trajectory={motion}")
    assert code == 0
    assert "Hold" in said


def test_a_plant_with_its_own_step_is_a_robot_of_a_file(typed: Typed) -> None:
    plant = "robot=PayloadTransfer(MobileRobot.box(), PayloadBody(3.0), 0.5)"
    assert "PayloadBody" in typed("write", plant, "controller=PD(100, 100)")[1]
    assert "MPC" not in typed("run", "robot=Nothing()")[2]  # it has a step, too: a time


MOTOR = "Motor(resistance=1.2, torque_constant=0.04, voltage=24, gear=30, rotor_inertia=2e-5)"
WHEELS = f"robot=WheelTable.differential(0.5, 0.1, spin_inertia=0.005, motor={MOTOR})"


@pytest.mark.once
@pytest.mark.long
def test_volts_of_wheels_give_the_robot_and_loads_the_scale(typed: Typed, tmp_path: Path) -> None:
    paths = []
    head = f"{HEAD[:9]},u_left [V],u_right [V],rate_left,rate_right"
    for k in range(2):
        table = np.column_stack([rows(rolled(bool(k))), np.asarray(rolled(bool(k)).wheel_rates)])
        paths.append(written(tmp_path / f"{k}.csv", table, head))
    words = [WHEELS, "method=weak", "--out", str(tmp_path)]
    load = 'loads=["none", "PayloadBody(8, (0.1, 0.05, 0), (0.0533, 0.0533, 0.0533, 0, 0, 0))"]'
    code, told, err = typed("identify", *paths, load, *words)
    assert (code, err) == (0, "")
    assert estimate("input_scale", told) == pytest.approx(1.0, abs=0.02)
