"""Logs as a person hands them to the command, and robots that take speeds."""

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from pinmobile import Log, MobileRobot, Rollout, VelocityRobot, identification, rk4
from pinmobile.arrays import Array
from pinmobile.cli import main
from pinmobile.cli.choices import DEFAULT_PRESET, OF_SPEEDS, velocity_robot
from pinmobile.cli.identify import _CALL, _SAID
from pinmobile.cli.scenario_file import read_grid
from pinmobile.controllers import Backstepping, RandomSteps, VelocityCommand
from pinmobile.identification import VELOCITY_ROBOTS
from pinmobile.loop import run_scenario
from tests import wheeled
from tests.test_identification import log, rolled
from tests.test_velocity_identification import logged

pytestmark = pytest.mark.once

HEAD = "t,x,y,psi,Fx,Fy,Mz"


def typed(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, str, str]:
    code = main(words)
    captured = capsys.readouterr()
    return code, captured.out, captured.err


def rows() -> Array:
    return table_of(log())


def table_of(read: Log) -> Array:
    assert read.q is not None
    return np.column_stack([read.t, read.q, read.u])


def written(path: Path, table: Array, head: str = HEAD) -> Path:
    np.savetxt(path, table, "%.9g", ",", header=head, comments="")
    return path


def test_identify_prints_the_table_and_draws_measured_beside_foretold(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    path, robot = written(tmp_path / "run.csv", rows()), tmp_path / "robot.urdf"
    robot.write_text(MobileRobot(30.0, 1.5).to_urdf())
    out = tmp_path / "figures"
    code, told, err = typed(capsys, "identify", str(path), "--out", str(out), "--urdf", str(robot))
    assert (code, err) == (0, "")
    low, high = map(float, re.findall(r"^mass +\S+ +(\S+) to (\S+) +kg$", told, re.MULTILINE)[0])
    assert low < 32 < high
    assert (
        len(re.findall(r"^\w+ +\S+ +\S+ to \S+ ", told, re.MULTILINE)) == 13
    )  # ten of the robot, three offsets
    for words in ("2201 samples at 50 Hz", "rms of 1.98 s ahead: x ", f"{out / 'run.png'}"):
        assert words in told
    assert (out / "run.png").stat().st_size > 20_000
    code, weak, _ = typed(
        capsys, "identify", str(path), "--out", str(out), "--method", "weak", "--delay", "0"
    )
    assert code == 0
    assert "weak, 22 segments" in weak


def test_a_log_of_commands_tells_theta(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    read = logged(pose=True)
    path = written(tmp_path / "run.csv", table_of(read), "stamp,px,py,angle [rad],v,w")
    columns = ["--column", "q=px,py,angle", "--column", "u=v,w"]
    code, told, _ = typed(capsys, "identify", str(path), *columns, "--out", str(tmp_path))
    assert code == 0
    assert re.search(r"^theta_6 +1\.0\d+", told, re.MULTILINE)
    assert "rms of 1.9 s ahead: x " in told
    code, _, err = typed(capsys, "identify", str(path), *columns, "--method", "weak", "--out", str(tmp_path))
    said = "--method does not apply to a log of commands of speed and yaw rate"
    assert (code, err) == (2, f"pinmobile: {said}\n")


def test_what_is_on_each_side_of_a_gap_is_one_robots(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    table, words = rows(), ["--method", "weak", "--out", str(tmp_path)]
    first = str(written(tmp_path / "first.csv", table[:700]))
    second = str(written(tmp_path / "second.csv", table[760:]))
    code, told, err = typed(capsys, "identify", first, second, *words)
    assert (code, err) == (0, "")
    assert "2141 samples at 50 Hz, 0 dropped" in told
    assert re.search(r"^mass +3[12](\.\d+)? ", told, re.MULTILINE)
    assert f"measured and foretold: {tmp_path / 'second.png'}" in told  # of the longest
    code, _, err = typed(capsys, "identify", first, *words)
    assert code == 2
    assert re.match(r"pinmobile: LOG is '\S+first\.csv': log is 14 s long", err)
    table[:, 4:] = table[::-1, 4:]
    other = str(written(tmp_path / "other.csv", table))
    code, _, err = typed(capsys, "identify", first, other, *words)
    assert code == 2
    assert re.match(r"pinmobile: LOG is '\S+first\.csv', '\S+other\.csv': log has inputs of which ", err)
    brief = str(written(tmp_path / "brief.csv", table[:20]))
    code, _, err = typed(capsys, "identify", first, brief, *words)
    assert code == 2
    assert re.match(r"pinmobile: LOG is '\S+brief\.csv': log is 0\.38 s long, too short", err)


def gap(table: Array) -> Array:
    return np.delete(table, np.s_[300:330], axis=0)


def scaled(column: slice, factor: float) -> Callable[[Array], Array]:
    def change(table: Array) -> Array:
        table[:, column] *= factor
        return table

    return change


def slower(table: Array) -> Array:
    t = table[:, 0].copy()
    for k in (1, 2, 3):
        table[:, k] = np.interp(t * (1 - 2e-3), t, table[:, k])
    return table


def backwards(table: Array) -> Array:
    table[:, 4:] = table[::-1, 4:]
    return table


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (lambda table: table[::-1], r"t\[1\] is 43\.98 s after 44\.0 s, expected more"),
        (gap, r"t has a gap from 5\.98 to 6\.6 s .*"),
        (scaled(np.s_[3:4], 180 / np.pi), r"q has psi from .*: are these degrees\?"),
        (scaled(np.s_[4:], 1000.0), r"log leads to a mass of 3\.\d+e\+04 kg, .* in newtons.*"),
        (lambda table: table[:600], r"log is 12 s long, too short, expected at least .*"),
        (lambda table: table * [1, 0, 0, 0, 1, 1, 1], r"log has poses that move by 0 m, .* see excitation"),
        (backwards, r"log has inputs of which the motion explains .*another robot.*"),
        (slower, r"log has poses whose delay changes by .*two clocks.*"),
        (scaled(np.s_[:1], 1000.0), r"t has steps of 20 s, expected seconds: are these milliseconds\?"),
    ],
)
def test_a_bad_log_is_answered_in_one_line(
    change: Callable[[Array], Array], text: str, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    path = written(tmp_path / "run.csv", change(rows()))
    code, told, err = typed(capsys, "identify", str(path), "--out", str(tmp_path))
    assert code == 2
    assert not told.strip()
    assert re.fullmatch(rf"pinmobile: LOG is '\S+run\.csv': {text}\n", err), err


def test_rows_without_numbers_are_counted(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    table = rows()
    table[[100, 500], 1] = np.nan
    path = written(tmp_path / "run.csv", table)
    code, told, _ = typed(capsys, "identify", str(path), "--method", "weak", "--out", str(tmp_path))
    assert code == 0
    assert "2199 samples at 50 Hz, 2 dropped" in told


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("none.csv", r"LOG is '\S+none\.csv', which cannot be read: No such file or directory"),
        ("run.csv --column q", "--column is 'q', expected ROLE=NAME,NAME, such as q=px,py,angle"),
        ("run.csv --column q=x,y", r"LOG is '\S+': q has shape \(2201, 2\), expected \(2201, 3\)"),
        ("run.csv --column q=x,y,spi", "unknown column of .* 'spi', did you mean 'psi'.*"),
        ("run.csv --column p=x", "unknown part of a log 'p', .*available: t, q, u, twist, wheel_rates"),
        ("run.csv --bag q", "--bag is 'q', expected ROLE=TOPIC, such as q=/odom"),
        ("run.csv --bag q=/odom", "--bag is .*, expected those of u and of q or twist, .*"),
        (
            "run.csv --bag q=/odom --column q=x,y,psi",
            "--column applies to a CSV file, and --bag to a bag, .*",
        ),
        ("run.csv --method ls", "unknown method 'ls', available: output-error, weak"),
        ("run.csv --delay 30", r"--delay is 30 s, expected 4\.4 s at most: are these milliseconds\?"),
        ("run.csv --urdf none.urdf", "--urdf is 'none.urdf', which cannot be read: .*"),
        (
            "odd.csv",
            r"LOG is '\S+', whose columns are a, b, c, d, Fx, Fy, Mz: none is known as that of t, expected "
            "--column ROLE=NAME,NAME of these, such as --column q=px,py,angle",
        ),
        ("bare.csv", r"LOG is '\S+', whose first line '0,\S+ has numbers, expected a header .*"),
        ("empty.csv", r"LOG is '\S+', which is empty, expected a header .*"),
    ],
)
def test_words_that_say_no_log_are_answered_in_one_line(
    words: str, message: str, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    written(tmp_path / "run.csv", rows())
    written(tmp_path / "odd.csv", rows()[:9], HEAD.replace("t,x,y,psi", "a,b,c,d"))
    np.savetxt(tmp_path / "bare.csv", rows()[:9], "%.9g", ",")
    (tmp_path / "empty.csv").write_text("")
    file, *more = words.split()
    code, _, err = typed(capsys, "identify", str(tmp_path / file), *more, "--out", str(tmp_path))
    assert code == 2
    assert re.fullmatch(f"pinmobile: {message}\n", err), err


# -- robots on wheels ------------------------------------------------------------------------------

DRIVE = "--drive differential --track 0.5 --wheel-radius 0.1"
NUMBERS = "--motor resistance=1.2,torque_constant=0.04,voltage=24,gear=30,rotor_inertia=2e-5 --wheel-mass 1"
ROUND = "0.003 0 0 0.005 0 0.003"
STEERED = wheeled.robot(
    wheeled.link("base", wheeled.inertial(20.0)),
    wheeled.wheels("base", [(0, 0.2, 0.1), (0, -0.2, 0.1)], 0.1, 0.04, 1.0, ROUND),
    wheeled.link("fork", wheeled.inertial(0.1)),
    wheeled.joint("swivel", "continuous", "base", "fork", "-0.3 0 0.1", axis="0 0 1"),
    wheeled.wheels("fork", [(-0.04, 0, 0)], 0.1, 0.04, 1.0, ROUND).replace("wheel_0", "caster"),
)


def on_wheels(path: Path, read: Log, unit: str) -> Path:
    assert read.wheel_rates is not None
    head = f"{HEAD[:9]},u_left [{unit}],u_right [{unit}],rate_left,rate_right"
    return written(path, np.column_stack([table_of(read), read.wheel_rates]), head)


def estimate(name: str, told: str) -> float:
    return float(re.findall(rf"^{name} +(\S+) ", told, re.MULTILINE)[0])


def test_volts_of_wheels_tell_the_robot_and_loads_the_scale(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    bare, loaded = (str(on_wheels(tmp_path / f"{k}.csv", rolled(bool(k)), "V")) for k in range(2))
    words = [*DRIVE.split(), *NUMBERS.split(), "--method", "weak", "--out", str(tmp_path)]
    code, told, err = typed(capsys, "identify", bare, *words)
    assert (code, err) == (0, "")
    assert estimate("mass", told) == pytest.approx(30.0, rel=0.02)
    assert estimate("yaw_inertia", told) == pytest.approx(1.3, rel=0.02)
    for said in (
        "differential: two driven wheels on one axle, two ball casters, of a body of which nothing is "
        "believed; wheels of 1 kg turn as uniform discs",
        "inputs: volts of left, right [V], in this order; Motor(resistance=1.2, ",
        "4.6 kg and 0.287 kg m^2 of it were taken as stated",  # of discs and rotors
        "run.csv loaded.csv --load none --load 8@0.1,0.05, say",
    ):
        assert said in told
    assert (tmp_path / "0.png").stat().st_size > 20_000
    loads = ["--load", "none", "--load", "8@0.1,0.05,0.0533"]
    code, told, err = typed(capsys, "identify", bare, loaded, *loads, *words)
    assert (code, err) == (0, "")
    assert estimate("input_scale", told) == pytest.approx(1.0, abs=0.02)
    light = [*DRIVE.split(), *NUMBERS.split()[:2], "--method", "weak", "--out", str(tmp_path)]
    code, told, _ = typed(capsys, "identify", bare, *light)
    assert code == 0
    assert estimate("mass", told) == pytest.approx(31.0, rel=0.02)  # with what the wheels turn with
    assert "wheels turn without inertia of their own" in told


def test_wheels_of_a_urdf_are_believed_and_those_of_a_drive_are_not(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    t, noise = 0.02 * np.arange(1500), np.random.default_rng(1).normal(0, 1e-3, (1500, 3))
    q = np.column_stack([np.sin(t), 0 * t, 0 * t]) + noise
    u = -0.0256 * np.sin(t)  # of 1.55 kg on wheels of 33 mm
    path = written(tmp_path / "run.csv", np.column_stack([t, q, u, u]), "t,x,y,psi,u_a,u_b")
    code, _, err = typed(capsys, "identify", str(path), *DRIVE.split(), "--out", str(tmp_path))
    assert code == 2
    assert re.fullmatch(
        r"pinmobile: LOG is '\S+run\.csv': log has a motion of rank \d of 8: .*, see excitation, or --urdf "
        "FILE of the robot, which is kept where nothing is seen\n",
        err,
    )
    urdf = tmp_path / "waffle.urdf"
    urdf.write_text(wheeled.turtlebot("waffle").replace("${namespace}", ""))
    words = ["--urdf", str(urdf), "--method", "weak", "--out", str(tmp_path)]
    code, told, err = typed(capsys, "identify", str(path), *words)
    assert (code, err) == (0, "")
    assert "waffle.urdf: wheels of its file: wheel_left_joint, wheel_right_joint; " in told
    assert "inputs: torques of wheel_left_joint, wheel_right_joint [N m], in this order" in told
    assert "the motion does not tell" in told
    pushed = str(written(tmp_path / "pushed.csv", rows()))
    code, told, _ = typed(capsys, "identify", pushed, *words)
    assert code == 0
    assert "waffle.urdf: inputs are forces on the body" in told
    assert estimate("mass", told) == pytest.approx(32.0, rel=0.02)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("--drive car", "unknown drive 'car', available: differential, mecanum, omni"),
        ("--drive differential", "--drive differential needs --track and --wheel-radius too"),
        (f"{DRIVE} --wheelbase 1", "--wheelbase does not apply to differential, which takes --track, --w.*"),
        ("--drive differential --track 0 --wheel-radius 1", "--track is 0.0 m, expected > 0"),
        ("--drive omni --distance 0.2 --wheel-radius 1", r"LOG is '\S+': log has 2 inputs, expected 3: .*"),
        (f"{DRIVE} --wheel-mass -1", "--wheel-mass is -1.0 kg, expected >= 0"),
        (f"{DRIVE} --urdf waffle.urdf", "--urdf does not apply beside --drive, whose numbers are options"),
        (f"{DRIVE} --motor maxon", "unknown motor 'maxon', available: dynamixel_.*, faulhaber_1331t012sr"),
        (f"{DRIVE} --motor gaer=2", "unknown number of --motor 'gaer', did you mean 'gear'.*"),
        (f"{DRIVE} --motor gear=a", "--motor gear is 'a', expected a number, .*"),
        (f"{DRIVE} --motor gear=2", "--motor is 'gear=2', without a resistance, expected .*"),
        (f"{DRIVE} --motor resistance=2", "--motor: torque_constant, voltage is not given, expected .*"),
        (f"{DRIVE} --load 3", r"--load is '3', expected none, KG@X,Y or KG@X,Y,INERTIA \[kg, .*"),
        (f"{DRIVE} --load 3@a,0", "--load is '3@a,0', expected none, .*"),
        (f"{DRIVE} --load=-3@0,0", "--load is '-3@0,0': mass is -3.0 kg, expected > 0"),
        (
            f"{DRIVE} --load none --load none",
            "--load comes 2 times, expected 1, one for each LOG in .*",
        ),
        (f"{DRIVE} --load none", "--load has the same for all logs, expected loads that differ: .*"),
        ("--load none", "--load does not apply to a log of commands of speed and yaw rate"),
        ("--motor pololu_37d_50_12v", "--motor applies to wheels, expected --drive or --urdf beside it"),
        ("--track 0.5", "--track applies beside --drive alone"),
        ("--rollers 0.785", "--rollers applies beside --urdf alone"),
        (
            "--urdf bare.urdf --motor pololu_37d_50_12v",
            r"--motor applies to wheels, and --urdf '\S+' has none",
        ),
        ("--urdf waffle.urdf --wheel-mass 1", "--wheel-mass does not apply beside --urdf"),
        ("--urdf waffle.urdf --rollers 2", "--rollers is 2 rad for 2 wheels that are not four.*"),
        (
            "--urdf husky.urdf",
            r"--urdf is '\S+husky\.urdf', whose wheels are on more .*, expected --rollers .*",
        ),
        ("--urdf steered.urdf", r"--urdf is '\S+steered\.urdf', with wheels that steer, expected wheels .*"),
    ],
)
def test_words_that_say_no_wheels_are_answered_in_one_line(
    words: str, message: str, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    path = on_wheels(tmp_path / "run.csv", rolled(False), "")
    files = {
        "bare": MobileRobot(30.0, 1.5).to_urdf(),
        "waffle": wheeled.turtlebot("waffle"),
        "husky": wheeled.husky(),
        "steered": STEERED,
    }
    for name, text in files.items():
        (tmp_path / f"{name}.urdf").write_text(text)
    told = [str(tmp_path / word) if word.endswith(".urdf") else word for word in words.split()]
    code, _, err = typed(capsys, "identify", str(path), *told, "--out", str(tmp_path))
    assert code == 2
    assert re.fullmatch(f"pinmobile: {message}\n", err), err


@pytest.mark.parametrize(
    ("unit", "words", "message"),
    [
        ("V", "", "speed in V, expected m/s: volts take --drive, or --urdf, and --motor of their wheels"),
        ("N m", "", "speed in N m, expected m/s: torques take --drive, or --urdf, .*, without --motor"),
        ("V", DRIVE, "left in V, expected N m: volts take --drive, or --urdf, and --motor of their wheels"),
        ("N m", f"{DRIVE} {NUMBERS}", "left in N m, expected V: torques take --drive, .*, without --motor"),
        (
            "m/s",
            DRIVE,
            "left in m/s, expected N m: commands of speed and yaw rate take neither .* nor --urdf",
        ),
        ("N*m", "", "speed in N m, expected m/s: .*"),
        ("mV", "--column u=u_left,u_right", "speed in V, expected m/s: .*"),
        ("A", DRIVE, "left in A, expected N m: currents take --load, once for each LOG, .* multiply by it"),
        ("mA", f"{DRIVE} --column u=u_left,u_right", "left in A, expected N m: currents take --load.*"),
        ("A", f"{DRIVE} {NUMBERS}", "left in A, expected V: currents take --load.*"),
        ("A", "", "speed in A, expected m/s: currents take --load.*"),
        ("kN", DRIVE, "left in N, expected N m: forces take neither --drive nor --motor"),
        ("kN", "", "speed in N, expected m/s: forces take neither --drive nor --motor"),
    ],
)
def test_units_of_a_header_say_what_inputs_are(
    unit: str, words: str, message: str, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    path = on_wheels(tmp_path / "run.csv", rolled(False), unit)
    code, _, err = typed(capsys, "identify", str(path), *words.split(), "--out", str(tmp_path))
    assert code == 2
    said = rf"LOG is '\S+run\.csv': log has input {message}"
    assert re.fullmatch(f"pinmobile: {said}\n", err), err


def test_a_twist_has_two_columns_and_dry_friction_its_speed(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    read = logged(pose=False)
    assert read.twist is not None
    table = np.column_stack([read.t, read.twist[:, [0, 2]], read.u])
    path = written(tmp_path / "run.csv", table, "t,u [m/s],w [deg/s],v_set [m/s],w_set [rad/s]")
    columns = ["--column", "twist=u,w", "--column", "u=v_set,w_set", "--out", str(tmp_path)]
    table[:, 2] = np.rad2deg(table[:, 2])
    written(path, table, path.read_text().splitlines()[0])
    code, told, err = typed(capsys, "identify", str(path), *columns)
    assert (code, err) == (0, "")
    assert re.search(r"^theta_6 +1\.0\d+", told, re.MULTILINE)
    code, _, err = typed(capsys, "identify", str(path), *columns, "--rolling-speed", "0.1")
    said = "--rolling-speed does not apply to a log of commands of speed and yaw rate"
    assert (code, err) == (2, f"pinmobile: {said}\n")
    pushed = str(written(tmp_path / "pushed.csv", rows()))
    words = ["--method", "weak", "--out", str(tmp_path)]
    friction = {
        speed: estimate("rolling_left", typed(capsys, "identify", pushed, *words, *speed)[1])
        for speed in ((), ("--rolling-speed", "0.01"), ("--rolling-speed", "0.1"))
    }
    assert friction[()] == friction["--rolling-speed", "0.01"] != friction["--rolling-speed", "0.1"]
    code, _, err = typed(capsys, "identify", pushed, *words, "--rolling-speed", "-1")
    assert (code, err) == (2, "pinmobile: --rolling-speed is -1.0 m/s, expected > 0\n")


def test_units_are_of_inputs_that_are_named(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    read = logged(pose=True)
    table = np.column_stack([table_of(read), read.u])
    path = written(
        tmp_path / "run.csv", table, "# of a robot\nt,x,y,psi,v [m/s],w [rad/s],u_left [V],u_right [V]"
    )
    words = ["--column", "u=v,w", "--out", str(tmp_path)]
    code, told, err = typed(capsys, "identify", str(path), *words)
    assert (code, err) == (0, "")
    assert "theta_6" in told


def test_messages_say_what_is_typed(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    table = rows()
    path = written(tmp_path / "run.csv", np.column_stack([table, table[:, 4]]), "t,x,y,psi,u_a,u_b,u_c,u_d")
    code, _, err = typed(capsys, "identify", str(path), "--out", str(tmp_path))
    assert code == 2
    assert (
        "of wheels that roll give --drive or --urdf, of commands of speed and yaw rate give two inputs" in err
    )
    assert "identify_velocity" not in err


# -- robots that take speeds -----------------------------------------------------------------------


def test_drive_drives_a_robot_that_takes_speeds(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    out = tmp_path / "out"
    words = ["--preset", "pioneer_3dx", "--duration", "2", "--dt", "0.02", "--out", str(out)]
    code, told, _ = typed(capsys, "drive", "velocity", *words, "--html", str(tmp_path / "v.html"))
    assert code == 0
    assert "pioneer_3dx: firmware follows speed and yaw rate late by 0.558 s and 0.205 s" in told
    assert "theta is that of a log, not of a type" in " ".join(told.split())
    values = dict(re.findall(r"^(largest error|the same).*\] +(\S+)$", told, re.MULTILINE))
    assert float(values["largest error"]) < 0.01 < 0.05 < float(values["the same"])
    assert {path.name for path in out.iterdir()} >= {"index.html", "path.png", "forces.png", "rollout.npz"}
    run = Rollout.load(out / "rollout.npz")
    assert [one.name for one in run.inputs] == ["speed command", "yaw rate command"]
    assert np.abs(run.error[:, :2]).max() < 0.01
    code, told, _ = typed(capsys, "drive", "velocity", "--theta", "0.3,0.3,0,1,0,1", "--duration", "1")
    assert code == 0
    assert "theta = 0.3, 0.3, 0, 1, 0, 1" in told
    assert "see it move: add --html" in told


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("velocity --preset Pioneer3-DX", "unknown preset 'Pioneer3-DX', did you mean 'pioneer_3dx' or .*"),
        ("velocity --theta 1,2", r"--theta has shape \(2,\), expected \(6,\)"),
        ("velocity --theta 1,a", "--theta is '1,a', expected a number, or numbers with commas"),
        ("velocity --theta 1 --preset khepera_3", "--theta stands in place of --preset, but there are both"),
        ("velocity --mu 0.5", "--mu does not apply to velocity, which takes --preset or --theta"),
        ("velocity --track 0.5", "--track does not apply to velocity, which takes --preset or --theta"),
        ("mecanum --preset khepera_3", "--preset applies to velocity alone"),
        ("velocty", "unknown drive 'velocty', did you mean 'velocity'.*"),
    ],
)
def test_words_that_say_no_such_robot_are_answered_in_one_line(
    words: str, message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    code, _, err = typed(capsys, "drive", *words.split())
    assert code == 2
    assert re.fullmatch(f"pinmobile: {message}\n", err), err


FILE = """
[robot]
type = "velocity"
preset = "pioneer_3dx"
limits = [1.0, 4.0]
[trajectory]
type = "circle"
radius = 1
rate = 0.5
duration = 4
[controller]
type = "backstepping"
law = {type = "tracking"}
[loop]
dt = 0.05
[spread]
"theta.theta_1" = {percent = 10}
controller.theta_4 = 1.0
start.x = {normal = [0, 0.01]}
[ensemble]
n = 20
[grid]
"robot.preset" = ["pioneer_3dx", "khepera_3"]
"""


def test_a_scenario_file_has_robots_that_take_speeds(tmp_path: Path) -> None:
    path = tmp_path / "speeds.toml"
    path.write_text(FILE)
    pioneer, khepera = read_grid(path).scenarios
    assert pioneer.robot == velocity_robot("pioneer_3dx", limits=(1.0, 4.0))
    assert khepera.robot.theta.tolist() == VELOCITY_ROBOTS["khepera_3"].theta.tolist()
    assert isinstance(pioneer.controller, Backstepping)
    assert pioneer.integrator is rk4  # the robot's own choice
    assert run_scenario(pioneer).max_error[:, :2].max() < 0.2
    path.write_text(
        FILE.replace('"backstepping"', '"velocity-command"').replace("controller.theta_4 = 1.0", "")
    )
    assert isinstance(read_grid(path).scenarios[0].controller, VelocityCommand)
    alone = FILE.split("[spread]")[0].replace('law = {type = "tracking"}', "seed = 3")
    path.write_text(alone.replace('"backstepping"', '"random-steps"').replace("pioneer_3dx", "robulab_10"))
    (one,) = read_grid(path).scenarios
    assert isinstance(one.controller, RandomSteps)
    assert one.robot.size == VELOCITY_ROBOTS["robulab_10"].size


@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        ('"velocity"', '"speeds"', r"3: unknown type of \[robot\] 'speeds', available: velocity"),
        ('"khepera_3"', '"khepera"', "23: unknown preset 'khepera', did you mean 'khepera_3'.*"),
        ("limits", "limit", "5: unknown argument of velocity 'limit', did you mean 'limits'.*"),
        ("limits = [1.0, 4.0]", "theta = [1, 2]", "23: preset is .*, expected one of them; presets: .*"),
        ("[1.0, 4.0]", "[1.0, -4.0]", "5: limits is -4.0 rad/s, expected > 0 .*"),
        ('"theta.theta_1"', "mass", "17: unknown parameter in spread 'mass', available: theta, .*"),
        ("theta_1", "theta_9", "17: unknown parameter in spread 'theta.theta_9', did you mean 'theta.*"),
        ('"tracking"', '"trakcing"', r"13: unknown controller\.law 'trakcing', did you mean 'tracking'.*"),
        ("law =", "lwa =", "13: unknown argument of backstepping 'lwa', .*"),
    ],
)
def test_a_typo_about_such_a_robot_is_answered_with_its_line(
    old: str, new: str, text: str, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    (tmp_path / "speeds.toml").write_text(FILE.replace(old, new))
    code, _, err = typed(capsys, "sweep", str(tmp_path / "speeds.toml"), "--out", str(tmp_path / "out"))
    assert code == 2
    assert re.match(rf"pinmobile: speeds\.toml:{text}$", err, re.MULTILINE), err


def test_the_preset_that_is_taken_is_there() -> None:
    assert isinstance(OF_SPEEDS["velocity"](DEFAULT_PRESET), VelocityRobot)


def test_what_the_command_says_otherwise_is_what_the_library_says() -> None:
    """Words that are typed stand for words of the library: these must be there, broken over lines or not."""
    package = Path(identification.__file__).parent
    library = "".join(path.read_text() for path in sorted(package.glob("*.py")))
    flat = re.sub(r'"\s*f?"', "", library)
    for said in (*_SAID, _CALL):
        assert said in flat, said
