"""MCAP files of rollouts: bit for bit by the library, and standard messages for all other programs."""

import json
from collections.abc import Iterator
from dataclasses import replace
from fractions import Fraction
from functools import cache
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pinmobile as pm
from pinmobile.cli.results import show_identification
from pinmobile.errors import FileError
from pinmobile.plant import PlantDescription
from pinmobile.signals import Signal
from tests.damage import answer, damaged
from tests.users import Follower, TwoWheels

pytest.importorskip("rosbags", reason="needs the extra bags")
pytest.importorskip("mcap", reason="needs the extra bags")

CIRCLE = pm.Tangent(pm.Circle(radius=2, rate=-2.5, duration=3.3))  # more than one turn
START = 1_700_000_000.7
ODD = [-0.0, np.nan, np.inf, -np.inf, 5e-324, 0.1]
NAMES = ["class", "slip margin", "slip-margin", "slip_margin_27", "", "t"]
NAMES += ['=1 # "\n\N{GREEK SMALL LETTER PHI}']


@cache
def run_of(kind: str) -> pm.Rollout:
    body = pm.MobileRobot(30, 1.3, com=(0.1, 0.05, 0.1))
    if kind == "user":
        return pm.simulate(TwoWheels(), Follower(), pm.Tangent(pm.Circle(2, 0.25, 2)), dt=0.02)
    if kind == "wheels":
        table = pm.WheelTable.differential(
            0.46, 0.1, supports=[(0.2, 0), (-0.2, 0)], mass=1.0, spin_inertia=0.005, motor=pm.Motor(5.0)
        )
        plant = pm.WheeledRobot(body, table, pm.Coulomb(0.5))
        return pm.simulate(plant, pm.Backstepping(pm.UnicycleTracking(), plant), CIRCLE, dt=0.11)
    if kind == "arm":
        robot = pm.MobileRobot.box().mount("ur5", (0.1, -0.05, 0.2, 0.4))
        whole = pm.WholeBody(robot, CIRCLE, pm.Hold(robot.rest[3:], 3.3))
        return pm.simulate(robot, pm.ComputedTorque(robot, 16, 8), whole, dt=0.11)
    run = pm.simulate(body, pm.ComputedTorque(body, 16, 8), CIRCLE, dt=0.11)
    odd = np.resize(ODD, len(run))
    odd[7] = np.frombuffer(b"\1\0\0\0\0\0\xf8\x7f")[0]  # a NaN with a payload
    signals = {name: Signal("N", np.roll(odd, k)) for k, name in enumerate(NAMES)}
    more = {"gap": Signal("", np.column_stack([odd, -odd])), "none": Signal("m", np.zeros((len(run), 0)))}
    return replace(run, signals={**run.signals, **signals, **more})


RUNS = pytest.mark.parametrize("kind", ["body", "arm", "wheels", "user"])


def content(run: pm.Rollout) -> dict[str, Any]:
    """Return all that a rollout holds, its numbers as bytes."""
    kept = {name: getattr(run, name) for name in ("t", "q", "v", "a", "u", "error")}
    kept |= {f"reference {name}": part for name, part in run.reference._asdict().items()}
    kept |= {f"signal {name}": values for name, (_, values) in run.signals.items()}
    units = [(name, unit) for name, (unit, _) in run.signals.items()]
    held = {name: (part.shape, part.tobytes()) for name, part in kept.items()}
    return held | {"rest": (units, run.engine, run.fallback_reason, run.plant)}


def written(run: pm.Rollout, folder: Path, **options: Any) -> Path:
    run.to_mcap(folder / "run.mcap", **options)
    return folder / "run.mcap"


def messages(path: Path) -> Iterator[tuple[str, int, Any]]:
    from rosbags.highlevel import AnyReader

    with AnyReader([path]) as reader:
        for connection, at, raw in reader.messages():
            yield connection.topic, at, reader.deserialize(raw, connection.msgtype)


@RUNS
def test_a_run_comes_back_bit_for_bit(kind: str, tmp_path: Path) -> None:
    run = run_of(kind)
    run.save(tmp_path / "run.npz")
    path = written(run, tmp_path)
    loaded = pm.Rollout.from_mcap(path)
    assert content(loaded) == content(pm.Rollout.load(tmp_path / "run.npz"))
    assert isinstance(loaded.plant, PlantDescription) == (kind == "user")
    loaded.to_mcap(tmp_path / "again.mcap")
    assert (tmp_path / "again.mcap").read_bytes() == path.read_bytes()


@RUNS
def test_other_programs_read_standard_messages(kind: str, tmp_path: Path) -> None:
    run, forces = run_of(kind), kind in ("body", "arm")
    found: dict[str, list[tuple[int, Any]]] = {}
    for topic, at, message in messages(written(run, tmp_path, start=START)):
        found.setdefault(topic, []).append((at, message))
    names = {"/pinmobile/sample", "/joint_states", "/input", "/odom", "/twist"}
    assert set(found) == names | ({"/wrench"} if forces else set())
    for each in found.values():
        assert len(each) == len(run)
        for exact, (at, message) in zip(run.t.tolist(), each, strict=True):
            assert abs(at - (Fraction(START) + Fraction(exact)) * 10**9) <= Fraction(1, 2)
            if hasattr(message, "header"):
                assert message.header.stamp.sec * 10**9 + message.header.stamp.nanosec == at
    joints, inputs, odometry, twists = (
        [message for _, message in found[name]] for name in ("/joint_states", "/input", "/odom", "/twist")
    )
    assert joints[0].name[:3] == ["x", "y", "psi"]
    assert np.array_equal([each.position for each in joints], run.q)
    assert np.array_equal([each.velocity for each in joints], run.v)
    efforts = run.u if forces else np.column_stack([np.zeros((len(run), 3)), run.u])
    known = kind != "user"  # its inputs have names that none of its coordinates has
    assert np.array_equal([each.effort for each in joints], efforts if known else np.zeros((len(run), 0)))
    assert np.array_equal([each.data for each in inputs], run.u)
    poses = [each.pose.pose for each in odometry]
    place = [(each.position.x, each.position.y) for each in poses]
    yaw = [2 * np.arctan2(each.orientation.z, each.orientation.w) for each in poses]
    np.testing.assert_allclose(place, run.poses[:, :2], rtol=0, atol=1e-12)
    np.testing.assert_allclose(np.exp(1j * np.array(yaw)), np.exp(1j * run.poses[:, 2]), rtol=0, atol=1e-12)
    for name, frame in [("/odom", "odom"), ("/twist", "base_link")]:
        assert {message.header.frame_id for _, message in found[name]} == {frame}
    for listed in ([each.twist.twist for each in odometry], [each.twist for each in twists]):
        forward, left, turn = np.array([(o.linear.x, o.linear.y, o.angular.z) for o in listed]).T
        along = (forward + 1j * left) * np.exp(1j * run.poses[:, 2])  # x + i y
        np.testing.assert_allclose(along, run.v[:, 0] + 1j * run.v[:, 1], rtol=0, atol=1e-12)
        assert np.array_equal(turn, run.v[:, 2])
    if forces:
        wrenches = [each.wrench for _, each in found["/wrench"]]
        assert [(w.force.x, w.force.y, w.torque.z) for w in wrenches] == [*map(tuple, run.u[:, :3])]


def test_the_metadata_and_the_definition_describe_the_samples(tmp_path: Path) -> None:
    """They need no pinmobile: JSON, and a message with a float64 field for each column."""
    from mcap.reader import make_reader

    run = run_of("body")
    path = written(run, tmp_path)
    texts = {each.name: each.metadata for each in make_reader(BytesIO(path.read_bytes())).iter_metadata()}[
        "pinmobile"
    ]
    assert (float(texts["dt"]), json.loads(texts["t"])) == (run.t[1], run.t.tolist())
    names, units, fields = (json.loads(texts[name]) for name in ("names", "units", "fields"))
    assert [*zip(names, units, strict=True)][:5] == [
        *(("t", "s"), ("x", "m"), ("y", "m"), ("psi", "rad")),
        ("v_x", "m/s"),
    ]
    assert names[-2:] == ["signal_gap[0]", "signal_gap[1]"]
    assert json.loads(texts["signals"])["slip margin"] == "N"
    samples = [message for topic, _, message in messages(path) if topic == "/pinmobile/sample"]
    table = dict(
        zip(names, np.array([[getattr(each, n) for n in fields] for each in samples]).T, strict=True)
    )
    expected = {"t": run.t, "psi": run.q[:, 2], "v_y": run.v[:, 1], "u_Mz": run.u[:, 2]}
    expected |= {"error_x": run.error[:, 0], "desired_psi": run.reference.q[:, 2]}
    expected |= {"desired_a_x": run.reference.a[:, 0]}
    expected |= {f"signal_{name}": run.signals[name].values for name in NAMES}
    for name, values in expected.items():
        assert table[name].tobytes() == values.tobytes(), name


def test_a_log_is_read_from_the_samples_or_from_standard_topics(tmp_path: Path) -> None:
    robot = pm.MobileRobot(30, 1.3, com=(0.1, 0.05))
    law, path = pm.ComputedTorque(robot, 16, 8), pm.excitation(robot, duration=22.0, period=11.0)
    run = pm.simulate(robot, law, path, dt=0.05, integrator=pm.rk4)
    file, direct = written(run, tmp_path, start=START), pm.Log.from_rollout(run)
    own = pm.Log.from_bag(file)
    for name in ("t", "q", "u"):
        assert getattr(own, name).tobytes() == getattr(direct, name).tobytes()
    assert own.units == ("N", "N", "N m")
    for topics in (
        {"u": "/wrench", "twist": "/odom"},
        {"u": "/joint_states", "twist": "/twist"},
        {"u": "/input"},
    ):
        log = pm.Log.from_bag(file, {"q": "/odom", **topics})
        np.testing.assert_allclose(log.t, run.t, rtol=0, atol=1.1e-9)
        np.testing.assert_allclose(log.q, run.q, rtol=0, atol=1e-12)  # type: ignore[arg-type]
    for log in (own, pm.Log.from_bag(file, {"q": "/odom", "u": "/wrench"})):
        found = pm.identify(log)
        assert found.interval(0.95)["mass"][0] - 0.05 < 30 < found.interval(0.95)["mass"][1] + 0.05
    assert show_identification([str(file), "method=weak", "delay=0"], tmp_path / "out") == 0


def foreign(path: Path) -> None:
    from mcap.writer import Writer

    with path.open("wb") as file:
        writer: Any = Writer(file)
        writer.start("ros2", "another")
        schema = writer.register_schema("std_msgs/msg/Float64", "ros2msg", b"float64 data\n")
        writer.add_message(writer.register_channel("/speed", "cdr", schema), 0, bytes(12), 0)
        writer.finish()


def test_another_file_is_refused_with_what_it_has(tmp_path: Path) -> None:
    path, begin = tmp_path / "run.mcap", "path is '.*run.mcap', which is not a 'pinmobile rollout 4' file of "
    foreign(path)
    for read in (pm.Rollout.from_mcap, pm.Log.from_bag):
        with pytest.raises(
            FileError, match=begin + ".*: its topics are /speed, expected /pinmobile/sample; Log"
        ):
            read(path)
    for content in (b"", b"t,x,y\n0,1,2\n"):
        path.write_bytes(content)
        with pytest.raises(FileError, match=begin + "Rollout.to_mcap: .*(EndOfFile|not a valid MCAP|seek)"):
            pm.Rollout.from_mcap(path)
    path.unlink()
    with pytest.raises(pm.InvalidArgument, match=r"run.mcap', which cannot be read: No such file"):
        pm.Rollout.from_mcap(path)


def test_damage_is_found_or_does_no_harm(tmp_path: Path) -> None:
    run = run_of("body")
    path = written(run, tmp_path)
    good, read = path.read_bytes(), 0
    for seed in range(50):
        path.write_bytes(damaged(good, np.random.default_rng(seed)))
        loaded = answer(lambda: pm.Rollout.from_mcap(path))
        assert isinstance(loaded, FileError) or content(loaded) == content(run)
        read += not isinstance(loaded, FileError)
    assert read < 20  # standard messages may be damaged, but no sample and no metadata


LATEST = r"^start is 2.147.*, expected at least 0 and less than 2147483648 s$"


@pytest.mark.parametrize(
    ("name", "options", "why"),
    [
        ("run.bag", {}, r"^path is '.*run.bag', expected a name that ends in '.mcap'$"),
        ("run.mcap", {"start": 2.0**31 - 1}, LATEST),
    ],
)
def test_impossible_files_are_refused(tmp_path: Path, name: str, options: dict[str, Any], why: str) -> None:
    (tmp_path / "run.mcap").write_bytes(b"kept")
    with pytest.raises(pm.InvalidArgument, match=why):
        run_of("body").to_mcap(tmp_path / name, **options)
    assert (tmp_path / "run.mcap").read_bytes() == b"kept"
