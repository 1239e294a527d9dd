"""The command as a person types it."""

import re
import shlex
import subprocess
import sys
from html import unescape
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.main import get_command

import pinmobile
from pinmobile import Circle, Line, MobileRobot, Moved, Polyline, Rollout
from pinmobile.cli import choices, main, options
from pinmobile.cli.commands import app
from pinmobile.cli.run import EXPECTED
from pinmobile.parts import Number, declared_by
from tests.damage import full_disk
from tests.wheeled import husky


def typed(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, str, str]:
    code = main(words)
    captured = capsys.readouterr()
    return code, captured.out, captured.err


@pytest.fixture(scope="module")
def lecture(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """Return the folder and the output of `pinmobile lecture`, in a process of its own."""
    folder = tmp_path_factory.mktemp("lecture") / "out"
    words = [sys.executable, "-m", "pinmobile", "lecture", "--out", str(folder)]
    done = subprocess.run(words, capture_output=True, text=True, check=False, timeout=300)
    assert done.returncode == 0, done.stderr
    return folder, done.stdout


@pytest.mark.once
def test_lecture_prints_every_number_beside_the_lectures(lecture: tuple[Path, str]) -> None:
    _, text = lecture
    for (trajectory, controller), (x, y) in EXPECTED.items():
        assert re.search(rf"{trajectory} +{controller} +{x} +{x} +{y} +{y}\n", text)
    assert "all twelve numbers are the lecture's, to every digit" in text
    assert "the routes agree" in text
    assert "M[psi, psi] = Icz + m*(xbc**2 + ybc**2)" in text
    assert all(len(line) <= 80 for line in text.splitlines() if "/" not in line)


def test_lecture_shows_both_headings_beside_each_other_and_says_of_which_the_figures_are(
    lecture: tuple[Path, str],
) -> None:
    folder, text = lecture
    page = unescape((folder / "index.html").read_text())
    for label in ("PD", "computed torque"):
        row = rf"{label} +(lecture's|put right) (60|62) s +(\S+) +(\S+) +(\S+|< 1e-12)$"
        printed = re.findall(rf"^(via stop|via free|circle) +{row}", text, re.MULTILINE)
        assert len(printed) == 6
        assert [one[2] for one in printed if one[1] == "put right"] == ["62", "60", "60"]
        for path, *rest in printed:
            section = page.split(f"{path.capitalize()}: PD beside")[1].split("<h2>")[0]
            assert tuple(rest) in re.findall(f"^{row}", section.replace("</pre>", ""), re.MULTILINE)
            assert "the figures show the heading that is put right" in section


@pytest.mark.once
def test_no_repr_is_in_a_page_s_title(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    robot = tmp_path / "mine.urdf"
    robot.write_text(MobileRobot(7, 0.5).to_urdf())
    for words, title in (
        (["--html"], "computed torque: circle, lecture robot"),
        (["--controller", "pd", "--urdf", str(robot), "--trajectory", "via-stop"], "PD: via stop, mine.urdf"),
    ):
        code, _, _ = typed(capsys, "run", *words, "--out", str(tmp_path / "out"))
        assert code == 0
        for page in ("index.html", *(["scene.html"] if "--html" in words else [])):
            assert f"<title>{title}</title>" in (tmp_path / "out" / page).read_text()


@pytest.mark.parametrize(
    ("words", "path"),
    [
        ("polyline", Polyline([(0, 0), (4, 0), (4, 3)], 0.5, 60)),
        (
            "polyline --waypoints 0,0,2,0,2,2 --corner-radius 0.3 --acceleration 0.1 --moved 1,2,0.5",
            Moved(Polyline([(0, 0), (2, 0), (2, 2)], 0.3, 60, 0.1), 1, 2, 0.5),
        ),
        ("line --end 2,3 --duration 30", Line((0, 0), (2, 3), 30)),
        ("circle --centre 1,2 --phase 0.5", Circle(3, 0.1, 60, (1, 2), 0.5)),
        ("circle --start-heading 1.5 --moved 1,2", Circle(3, 0.1, 60, heading=1.5).moved(1, 2)),
    ],
)
def test_run_puts_paths_anywhere(
    words: str, path: Any, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    code, _, _ = typed(capsys, "run", "--trajectory", *words.split(), "--out", str(tmp_path))
    assert code == 0
    run = Rollout.load(tmp_path / "rollout.npz")
    np.testing.assert_allclose(run.reference.q[:, :2], path(run.t), rtol=0, atol=1e-14)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("polyline --waypoints 0,0,1", "--waypoints has 3 numbers, expected X,Y of each point"),
        ("polyline --waypoints 0,0,1,0,0,0", "waypoints[1] is where the way turns by 180 degrees"),
        ("line --moved 1", "--moved is '1', expected X,Y or X,Y,ANGLE"),
        ("circle --phase 1 --start-heading 1", "--start-heading is 1.0 rad beside phase = 1.0 rad"),
        ("line --centre 1,2", "--centre does not apply to the trajectory 'line', which takes --duration"),
    ],
)
def test_run_refuses_paths_that_cannot_be(
    words: str, message: str, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    code, _, err = typed(capsys, "run", "--trajectory", *words.split(), "--out", str(tmp_path))
    assert code == 2
    assert message in err


def test_lecture_shows_what_wheels_change(lecture: tuple[Path, str]) -> None:
    folder, text = lecture
    shown = text.split("4  On wheels")[1]
    rows = re.findall(
        r"^(via stop|via free|circle) +(PD|computed torque\*)((?: +\S+){4})$", shown, re.MULTILINE
    )
    found = {(path, controller): [float(x) for x in numbers.split()] for path, controller, numbers in rows}
    assert len(found) == 6
    for (path, controller), (free, back, rolled, left) in found.items():
        assert back == free, "the free body slides back to its path"
        if controller == "PD":
            assert left > 5 * rolled, "wheels do not push sideways"
            assert rolled < (free / 20 if path == "circle" else 2 * free)
        else:
            assert max(rolled, left) < 1e-4
    assert "turns its heading by 0.785 rad at once at t = 0.1 s" in shown
    page = (folder / "index.html").read_text()
    assert re.search(r'<img src="wheels.png" alt="[^"]+"', page)


def test_lecture_writes_every_figure_with_an_index_that_says_what_it_shows(lecture: tuple[Path, str]) -> None:
    folder, text = lecture
    page = (folder / "index.html").read_text()
    kinds = ("animation.gif", "path.png", "states.png", "errors.png", "forces.png")
    figures = {f"{name}-{kind}" for name in ("via-stop", "via-free", "circle") for kind in kinds}
    pages = {f"{name}.html" for name in ("via-stop", "via-free", "circle")}
    assert {path.name for path in folder.iterdir()} == {
        *figures,
        *pages,
        "derivation.txt",
        "index.html",
        "wheels.png",
    }
    for name in pages:
        assert f'<a href="{name}">' in page
    assert text.endswith(f"see it move: open {folder / 'circle.html'}\n")
    for name in figures:
        assert re.search(rf'<img src="{name}" alt="[^"]+"', page)
        assert 1_000 < (folder / name).stat().st_size < 1_000_000
    assert "http" not in page
    assert f"open {folder / 'index.html'}" in text
    assert (
        "Newton" in (folder / "derivation.txt").read_text()
        or "force" in (folder / "derivation.txt").read_text()
    )


@pytest.mark.once
def test_lecture_says_no_when_a_number_is_not_the_lectures(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(EXPECTED, ("circle", "PD"), ("7.481304e-03", "7.481287e-03"))
    monkeypatch.setattr("pinmobile.cli.run.draw", lambda *_: [])
    code, out, _ = typed(capsys, "lecture", "--no-gif", "--out", str(tmp_path))
    assert code == 1
    assert "some numbers are NOT the lecture's: see the rows marked DIFFERS" in out
    assert out.count("  DIFFERS\n") == 1


def test_verify_answers_for_numbers_and_for_a_file(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    code, out, _ = typed(capsys, "verify", "--table", "slide", "--states", "20")
    assert code == 0
    assert "every route agrees" in out
    path = tmp_path / "mine.urdf"
    path.write_text(MobileRobot(7, 0.5, com=(0.1, 0)).to_urdf())
    code, out, _ = typed(capsys, "verify", "--urdf", str(path), "--states", "20")
    assert code == 0
    assert "mine.urdf is the chain (y, x, psi); mass 7 kg" in out
    code, out, _ = typed(capsys, "verify", "--urdf", str(path), "--states", "5", "--ground", "-0.1")
    assert code == 0
    assert "centre of mass (0.1, 0, 0.1) m" in out
    assert "ground as given, at z = -0.1 m in the root link's frame" in out


def test_other_numbers_leave_how_the_robot_of_a_file_stands(tmp_path: Path) -> None:
    path = tmp_path / "husky.urdf"
    path.write_text(husky())
    read = MobileRobot.from_urdf(path)
    changed = options.robot(read, mass=70.0, com=(0.1, 0.0))
    assert (changed.mass, changed.com) == (70.0, (0.1, 0.0, read.com[2]))
    assert changed.stance == read.stance
    assert "with other mass, com" in changed.source


def test_derive_prints_text_or_latex(capsys: pytest.CaptureFixture[str]) -> None:
    code, text, _ = typed(capsys, "derive")
    assert code == 0
    assert "Mass matrix" in text
    code, latex, _ = typed(capsys, "derive", "--latex")
    assert code == 0
    assert r"\ddot{\psi}" in latex


@pytest.mark.parametrize("drive", ["differential", "roller", "car"])
def test_derive_prints_the_reduced_model_of_a_drive(capsys: pytest.CaptureFixture[str], drive: str) -> None:
    code, text, _ = typed(capsys, "derive", "--drive", drive)
    assert code == 0
    assert "\nNull space\n" in text
    assert "\nn_nu =\n" in text
    code, latex, _ = typed(capsys, "derive", "--drive", drive, "--latex")
    assert code == 0
    assert "S^T M S" in latex


def test_run_is_the_lectures_circle_by_default(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    code, out, _ = typed(capsys, "run", "--out", str(tmp_path / "a" / "b"))
    assert code == 0
    assert "largest error: x 3.491279e-05 m, y 3.491278e-05 m" in out
    assert f"open {tmp_path / 'a' / 'b' / 'index.html'}" in out
    rollout = Rollout.load(tmp_path / "a" / "b" / "rollout.npz")
    assert rollout.max_error()[0] == pytest.approx(3.491279e-05, rel=1e-6)
    assert (tmp_path / "a" / "b" / "rollout.csv").read_text().startswith("t [s],x [m],y [m],psi [rad]")


def test_run_takes_a_trajectory_a_controller_a_robot_and_their_parameters(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    words = "run --trajectory via-stop --via 1,2 --duration 30 --t-via 10 --turn-time 1 --controller pd"
    words += " --kp 100,100,50 --kd 90,90,40 --robot box --mass 20 --com 0.1,0 --dt 0.05 --integrator rk4"
    words += " --substeps 2"
    code, out, _ = typed(capsys, *words.split(), "--out", str(tmp_path))
    assert code == 0
    assert "robot: MobileRobot(mass=20.0, yaw_inertia=1.3" in out
    rollout = Rollout.load(tmp_path / "rollout.npz")
    assert rollout.t[-1] == 31
    np.testing.assert_allclose(rollout.reference.q[210, :2], (1, 2))


@pytest.mark.once
def test_run_with_a_model_that_is_wrong(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    options = ["run", "--duration", "10", "--dt", "0.01", "--out", str(tmp_path)]
    typed(capsys, *options)
    right = Rollout.load(tmp_path / "rollout.npz").max_error()
    typed(capsys, *options, "--model-mass", "40")
    assert Rollout.load(tmp_path / "rollout.npz").max_error()[0] > 10 * right[0]


def test_a_run_that_diverges_keeps_what_came_before(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    code, out, err = typed(capsys, "run", "--controller", "pd", "--com", "0.1,0.05", "--out", str(tmp_path))
    assert code == 1
    assert err.startswith("pinmobile: the loop diverged at t = ")
    assert err.count("\n") == 1
    assert "up to there:" in out
    assert len(Rollout.load(tmp_path / "rollout.npz")) > 3


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (
            ["run", "--trajectory", "circel"],
            "unknown trajectory 'circel', did you mean 'circle'? available: circle, lissajous, via-stop,",
        ),
        (["run", "--controller", "lqr"], "unknown controller 'lqr', available: computed-torque, pd"),
        (
            ["run", "--heading", "tangnt"],
            "unknown heading 'tangnt', did you mean 'tangent'? available: tangent, fixed, lecture",
        ),
        (["run", "--integrator", "euler"], "unknown integrator 'euler', available:"),
        (
            ["run", "--robot", "lecure"],
            "unknown robot 'lecure', did you mean 'lecture'? available: lecture, box",
        ),
        (
            ["derive", "--table", "slides"],
            "unknown table 'slides', did you mean 'slide'? available: slide, lecture",
        ),
        (["derive", "--drive", "cart"], "unknown drive 'cart', did you mean 'car'? available: car, "),
        (["derive", "--drive", "car", "--table", "slide"], "--table does not apply beside --drive"),
        (
            ["run", "--radius", "1", "--trajectory", "via-free"],
            "--radius does not apply to the trajectory 'via-free'",
        ),
        (["run", "--kp", "4,a"], "--kp is '4,a', expected a number, or numbers with commas"),
        (["run", "--kp", "4,4"], "kp has shape (2,), expected (), (3,) or (3, 3)"),
        (["run", "--dt", "fast"], "--dt"),
        (["run", "--mass", "-1"], "mass is -1.0 kg, expected > 0"),
        (["run", "--urdf", "missing.urdf"], "--urdf is 'missing.urdf', which cannot be read"),
        (["run", "--ground", "-0.1"], "--ground applies beside --urdf alone"),
        (["verify", "--ground", "-0.1"], "--ground applies beside --urdf alone"),
        (["run", "--radios", "1"], "No such option"),
        (["verify", "--urdf", "missing.urdf"], "--urdf is 'missing.urdf', which cannot be read"),
        (["verify", "--com", "1"], "com has shape (1,), expected (2,) or (3,)"),
        (["view", "--speed", "0"], "--speed is 0.0, expected > 0"),
        (["view", "--html"], "--html does not apply to view, which writes no files"),
        (["view", "--trajectory", "circel"], "unknown trajectory 'circel'"),
        (["lectur"], "No such command"),
        (["run", "--model-mass", "-3"], "--model-mass is -3.0 kg, expected > 0"),
        (["run", "--model-com", "1,nan"], "--model-com[1] is nan, expected a finite number"),
        (["run", "--trajectory", "via-stop", "--duration", "-3"], "--duration is -3.0 s, expected > 0"),
        (["run", "--t-via", "90", "--trajectory", "via-free"], "--t-via is 90.0 s, expected 0 < t_via"),
        (["run", "--heading", "fixed", "--turn-time", "3"], "--turn-time does not apply beside --heading f"),
        (["verify", "--states", "0"], "--states is 0, expected a whole number >= 1"),
    ],
)
def test_wrong_options_are_answered_in_one_line(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, words: list[str], text: str
) -> None:
    out = ["--out", str(tmp_path)] if words[0] == "run" else []
    code, _, err = typed(capsys, *words, *out)
    assert code == 2
    assert err.startswith("pinmobile: ")
    assert text in err
    assert err.count("\n") == 1


@pytest.mark.parametrize("command", ["lecture", "run"])
def test_an_output_folder_that_cannot_be_written_is_refused_before_any_work(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, command: str
) -> None:
    (tmp_path / "file").write_text("")
    code, out, err = typed(capsys, command, "--out", str(tmp_path / "file" / "out"))
    assert code == 2
    assert "which cannot be written to" in err
    assert out == ""


def test_help_teaches(capsys: pytest.CaptureFixture[str]) -> None:
    for words in ([], ["--help"]):
        _, out, _ = typed(capsys, *words)
        for command in ("lecture", "verify", "derive", "run"):
            assert command in out
    _, out, _ = typed(capsys, "run", "--help")
    assert "Example" in out
    assert "(m/s)" in out
    assert "[/" not in out


def test_options_are_what_the_parts_state_with_the_lectures_numbers() -> None:
    names = set()
    for offered in (choices.PATHS, choices.HEADINGS):
        for choice in offered.values():
            for name, each in declared_by(choice.make) if isinstance(choice.make, type) else ():
                if isinstance(each, Number) and name in choice.takes and name != "duration":
                    option = choices.OPTIONS[name]
                    assert f"{each.doc.split(',')[0]}".lower() in option.text.lower()
                    end = "." if choice.takes[name] is None else "; "
                    assert f" ({each.unit}){end}" in option.text
                    names.add(option.name)
    assert {"radius", "rx", "via", "turn_time", "psi"} <= names
    circle = choices.PATHS["circle"].takes
    assert choices.OPTIONS["radius"].text == f"circle: radius of the circle (m); {circle['radius']:g}."
    assert choices.OPTIONS["model_mass"].text == "Mass of the controller's model (kg); the robot's."
    command: Any = get_command(app)
    own = {"out", "gif", "mp4", "html", "help"}
    assert {each.name for each in command.commands["run"].params} - own == {
        option.name for option in choices.OF_LOOPS
    }


def test_films_are_told_frame_by_frame_or_refused_before_anything_runs(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    pytest.importorskip("imageio_ffmpeg", reason="needs the extra mp4")

    def save(recording: Any, path: Path, *, progress: Any) -> None:
        assert recording.duration / recording.speed == pytest.approx(10)  # a minute in ten seconds
        progress(1, 2)
        path.write_bytes(b"film")

    words = "run", "--mp4", "--dt", "0.1", "--out", str(tmp_path)
    monkeypatch.setattr("pinmobile.viewer.Recording.save_mp4", save)
    monkeypatch.setenv("PINMOBILE_CHROMIUM", sys.executable)  # any program: none is started
    assert typed(capsys, *words)[0] == 0
    assert (tmp_path / "film.mp4").read_bytes() == b"film"
    assert '<video src="film.mp4" controls' in (tmp_path / "index.html").read_text()
    monkeypatch.setenv("PINMOBILE_CHROMIUM", "no-such-program")
    monkeypatch.setattr("pinmobile.cli.run.simulate", None)
    code, _, err = typed(capsys, *words)
    assert (code, err) == (2, "pinmobile: PINMOBILE_CHROMIUM is 'no-such-program', which is no program\n")


def test_version(capsys: pytest.CaptureFixture[str]) -> None:
    assert typed(capsys, "--version")[:2] == (0, f"pinmobile {pinmobile.__version__}\n")


def test_an_interrupt_ends_quietly(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupt(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("pinmobile.cli.run.show_lecture", interrupt)
    code, _, err = typed(capsys, "lecture")
    assert (code, err) == (130, "pinmobile: interrupted\n")


@pytest.mark.parametrize(
    ("words", "file"),
    [
        ("lecture --no-gif --out OUT", "via-stop-path.png"),
        ("run --dt 0.5 --out OUT", "rollout.npz"),
        ("ensemble --n 20 --duration 6 --spread mass=percent:20 --out OUT", "bands.png"),
        ("mount ur5 --dt 0.01 --duration 1 --out OUT", "computed-torque.npz"),
        ("mount ur5 --dt 0.01 --duration 1 --html OUT/ur5.html", "ur5.html"),
    ],
)
def test_a_full_disk_is_told_in_one_line_that_names_the_file(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, words: str, file: str
) -> None:
    (tmp_path / file).write_bytes(b"good")
    with full_disk(5000):
        code, _, err = typed(capsys, *words.replace("OUT", str(tmp_path)).split())
    assert code == 1
    assert err == (f"pinmobile: path is {str(tmp_path / file)!r}, which cannot be written: File too large\n")
    assert [(each.name, each.read_bytes()) for each in tmp_path.iterdir()] == [(file, b"good")]


@pytest.mark.parametrize(
    ("closed", "options", "code", "text"),
    [
        (">&-", "--duration 1", 0, ""),
        (">&-", "--duration 0", 2, "pinmobile: --duration is 0.0 s, .*"),
        (">&- 2>&-", "--duration 1", 0, ""),
        ("2>&-", "--duration 0", 2, ""),
    ],
)
def test_a_closed_output_is_no_output(
    closed: str, options: str, code: int, text: str, tmp_path: Path
) -> None:
    words = f"exec {shlex.quote(sys.executable)} -m pinmobile run --out . --dt 0.1 {options} {closed}"
    done = subprocess.run(
        ["sh", "-c", words], capture_output=True, text=True, check=False, timeout=100, cwd=tmp_path
    )
    assert done.returncode == code
    assert re.fullmatch(text, (done.stdout + done.stderr).strip()), done
    assert (tmp_path / "rollout.npz").exists() == (code == 0)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="Linux alone has a device that is full")
def test_a_console_behind_which_the_disk_is_full_is_told_in_one_line() -> None:
    words = [sys.executable, "-m", "pinmobile", "derive"]
    with Path("/dev/full").open("wb") as full:
        done = subprocess.run(words, stdout=full, stderr=subprocess.PIPE, check=False, timeout=100)
    assert done.returncode == 1
    assert done.stderr == b"pinmobile: the output cannot be written: [Errno 28] No space left on device\n"
