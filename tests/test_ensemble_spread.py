"""What is drawn for an ensemble, what is refused, and how it is summed up."""

import re
from typing import Any

import numpy as np
import pytest
from scipy import stats

import pinmobile as pm
from pinmobile.compiled import BINS
from pinmobile.derivatives import gradient
from pinmobile.errors import UnknownName
from pinmobile.forces import NoiseForce, PayloadForce, SinusoidalForce
from pinmobile.loop import TRUE_MODEL, ErrorQuantile, Relative, causes, run_scenario
from pinmobile.loop._description import bins_of, quantiles
from pinmobile.parts import evolved
from tests.refusals import refusals, refused, unknown

ROBOT = pm.MobileRobot(30.0, 1.3, com=(0.1, 0.02))
TRAJECTORY = pm.Tangent(pm.Circle(3.0, 0.1, 60.0))
WITH_ARM = ROBOT.mount("ur5")
DELAYED = pm.MeasurementDelay(pm.PD(4, 4), 3)
MOTOR = pm.Motor(resistance=2.0, torque_constant=0.1, voltage=24.0, gear=10.0, rotor_inertia=1e-4)


def made(**changes: Any) -> pm.Scenario:
    chosen: dict[str, Any] = {"robot": ROBOT, "controller": pm.ComputedTorque(ROBOT)}
    chosen |= {"trajectory": TRAJECTORY, "n": 1000, "spread": {}, "dt": 0.1, "duration": 1.0}
    return pm.Scenario(**chosen | changes)


def test_draws_follow_their_distributions() -> None:
    spread = {"mass": pm.Uniform(20, 40), "com.x": pm.Normal(0.1, 0.02), "kp": stats.gamma(4), "com.y": 0.03}
    draws = made(n=20_000, spread=spread).draws()
    # The largest deviation of a sample of n from its distribution exceeds 1.95 / sqrt(n) once in 1000
    # (Smirnov); the seed is fixed.
    laws = {"mass": stats.uniform(20, 20), "com.x": stats.norm(0.1, 0.02), "kp": stats.gamma(4)}
    for name, law in laws.items():
        assert stats.kstest(draws[name], law.cdf).statistic < 1.95 / np.sqrt(20_000)
    assert (draws["com.y"] == 0.03).all()
    assert abs(np.corrcoef(draws["mass"], draws["com.x"])[0, 1]) < 4 / np.sqrt(20_000)


def test_a_pattern_means_each_of_its_numbers_and_each_has_its_own_draw() -> None:
    table = pm.WheelTable.differential(0.4, 0.1, spin_inertia=0.01, motor=MOTOR)
    robot = pm.WheeledRobot(ROBOT, table)
    law = pm.Backstepping(pm.UnicycleTracking(), robot)
    scenario = made(robot=robot, controller=law, spread={"plant.*.gear": pm.Uniform(9, 11), "mass": 31.0})
    paths = [f"plant.table.wheels.{side}.motor.gear" for side in ("left", "right")]
    assert list(scenario.spread) == [*paths, "mass"]
    assert scenario.find("left.gear").path == paths[0]
    left, right = (scenario.draws()[path] for path in paths)
    assert abs(np.corrcoef(left, right)[0, 1]) < 0.2
    found = pm.ensemble(robot, law, TRAJECTORY, n=50, spread=scenario.spread, dt=0.1, duration=1.0)
    names = {one.name for one in causes(found, np.arange(50) < 5)}
    assert names == {"left.motor.gear", "right.motor.gear"}
    with unknown(r"unknown parameter in spread 'plant\.\*\.geer'"):
        made(robot=robot, controller=law, spread={"plant.*.geer": 1.0})
    with refused(r"spread has 'gear', .* or 'plant\.\*\.gear', which means all$"):
        made(robot=robot, controller=law, spread={"gear": 1.0})


def test_the_first_word_robot_means_the_plant() -> None:
    robot = pm.WheeledRobot(ROBOT, pm.WheelTable.differential(0.4, 0.1, spin_inertia=0.01))
    law = pm.ControlAllocation(pm.PD(120, 120), robot)
    found = made(robot=robot, controller=law, spread={"robot.*.radius": Relative(pm.Uniform(0.9, 1.1))})
    assert list(found.spread) == [f"plant.table.wheels.{side}.radius" for side in ("left", "right")]
    with unknown(r"unknown parameter in spread 'robot\.mas', did you mean 'robot\.mass'"):
        made(spread={"robot.mas": pm.Uniform(20, 40)})


def test_draws_of_an_array_are_factors_without_a_unit() -> None:
    law = pm.PD((120, 120, 12), (60, 60, 6))
    parameters = made(controller=law, spread={"kp": Relative(pm.Uniform(0.5, 1.5)), "kd.x": 50.0}).parameters
    assert (parameters["kp"].unit, parameters["kd.x"].unit) == ("", "N s/m")
    assert parameters["kp"].meaning.startswith("factor of ")


def test_a_factor_needs_a_number_and_a_copy_needs_one_number() -> None:
    law = pm.PD((120, 120, 12), (60, 60, 6))
    for other, source in (("kd", "kp"), ("kd.psi", "kp.psi")):
        with refused(
            rf"^spread\['{other}'\] is the same as '{source}', but 'kp' changes the whole array: .*kp.x"
        ):
            made(controller=law, spread={"kp": Relative([1.0] * 1000), other: pm.SameAs(source)})
    found = made(controller=law, n=2, spread={"kp.psi": Relative([1, 2]), "kd.psi": pm.SameAs("kp.psi")})
    assert found.values(found.draws(), 0, 2)["controller.kd"].tolist() == [[60, 60, 12], [60, 60, 24]]
    for spread in ({"phase": Relative(1.0)}, {"heading": pm.SameAs("phase")}):
        with refused(r"is a factor of trajectory.path.phase, .* which is None, expected a number there"):
            made(spread=spread)
    still = pm.MobileRobot(30, 1.3)
    with refused(r"^spread\['com.x'\] is a factor of plant.com.x, which is 0, expected a distribution"):
        made(robot=still, spread={"com.x": Relative(1.5)})
    assert list(made(robot=still, spread={"plant.*": Relative(1.5)}).spread) == [
        "plant.mass",
        "plant.yaw_inertia",
    ]
    with refused(r"^by has 'phase', angle of the start on the circle, which is None"):
        gradient("distance", ROBOT, law, TRAJECTORY, by=["phase"], dt=0.1)


def test_numbers_of_the_plant_without_effect_are_named() -> None:
    robot = pm.WheeledRobot(
        ROBOT, pm.WheelTable.differential(0.4, 0.1, spin_inertia=0.01, supports=[(0.2, 0.0)])
    )
    law = pm.ControlAllocation(pm.PD(120, 120), robot)

    def run(**spread: Any) -> Any:
        options: Any = {"spread": spread, "n": 3, "dt": 0.1, "duration": 1.0}
        return pm.ensemble(robot, law, TRAJECTORY, **options).max_error

    whole = "'plant.table.wheels.left.friction.rolling', 'plant.table.wheels.right.friction.rolling'"
    with pytest.warns(UserWarning, match=rf"^no law of this loop uses {whole} of the spread: the values"):
        found = run(**{"plant.*.rolling": pm.Uniform(0.0, 0.1)})
    assert np.ptp(found, axis=0).max() == 0
    # What another number follows has its effect there, and friction acts on dry ground.
    assert (
        np.ptp(run(**{"left.rolling": pm.Uniform(50, 60), "kp": pm.SameAs("left.rolling")}), axis=0).min() > 0
    )
    robot = evolved(robot, {"ground": pm.Coulomb(0.8)})
    assert np.ptp(run(**{"plant.*.rolling": pm.Uniform(0.0, 0.1)}), axis=0).max() > 0


def test_an_array_that_changes_later_changes_nothing() -> None:
    masses = np.linspace(20, 40, 5)
    scenario = made(n=5, spread={"mass": masses, "com.x": pm.SameAs("mass", masses)})
    before = {name: column.copy() for name, column in scenario.draws().items()}
    masses[:] = 1.0
    np.testing.assert_equal(scenario.draws(), before)
    assert before["mass"].max() == 40


def test_same_makes_the_controller_know_what_it_is_told() -> None:
    truth = {"mass": pm.Uniform(20, 40), "com.x": pm.Normal(0.1, 0.05)}
    told, nominal = (
        run_scenario(made(spread=spread, duration=60.0)).error_quantile(0.99).distance
        for spread in ({**truth, **TRUE_MODEL}, truth)
    )
    # With the true model what is left is the held force: that of the lecture's table, 3.5e-5 m on each axis.
    assert told < 1e-4 < nominal
    off = made(spread={"controller.mass": pm.SameAs("mass", pm.Uniform(0.8, 1.2))}).draws()["controller.mass"]
    assert 24 <= off.min() < 25
    assert 35 < off.max() <= 36


def test_a_gain_may_be_a_multiple_of_one_that_is_not_spread() -> None:
    spread = {"kd": pm.SameAs("kp", 2.0)}
    assert made(n=2, controller=pm.PD(5, 1), spread=spread).draws()["kd"].tolist() == [10, 10]
    several = made(n=2, controller=pm.PD((5, 6, 7), 1), spread={"kp.y": pm.SameAs("kp.psi", 3.0)})
    assert several.draws()["kp.y"].tolist() == [21, 21]
    with refused(r"refers to 'controller\.kp', an array of different numbers, expected a single number"):
        made(n=2, controller=pm.PD((5, 6, 7), 1), spread=spread).draws()


def test_a_member_is_the_robot_that_was_drawn() -> None:
    spread = {
        "mass": pm.Uniform(20, 40),
        "controller.mass": pm.SameAs("mass", 1.1),
        "kp": 5.0,
        "kd.psi": 7.0,
        "start.y": 0.3,
        "force.x": pm.Uniform(1, 2),
        "coefficients.yaw": 0.3,
    }
    forces = pm.ConstantForce((0, 0, 0)), pm.ViscousFriction((0, 0, 0))
    run = run_scenario(made(spread=spread, n=8, forces=forces))
    member = run.arguments(7)
    controller: Any = member.controller
    assert member.robot.mass == run.draws["mass"][7]
    assert controller.robot.mass == pytest.approx(1.1 * member.robot.mass, rel=1e-15)
    np.testing.assert_array_equal(controller.kp, [5, 5, 5])
    np.testing.assert_array_equal(controller.kd, [4.0, 4.0, 7.0])
    assert member.options["q0"].tolist() == [0.0, 0.3, 0.0]
    steady, viscous = member.options["forces"]
    assert steady.force.tolist() == [run.draws["force.x"][7], 0.0, 0.0]
    assert viscous.coefficients.tolist() == [0.0, 0.0, 0.3]


FORCED = (
    SinusoidalForce((9, 8, 7), 0.5, 0.1),
    NoiseForce((6, 5, 4), 1.0, seed=0),
    pm.RollingResistance((1, 1, 0.1), 0.05),
    pm.JointFriction(0.1, 0.1, 0.05),
    PayloadForce(1.0, (0.1, 0.1), 0.5, 0.1),
    pm.ConstantForce((1, 1, 0.1), 0.1, 0.8),
    pm.ViscousFriction((1, 1, 0.1)),
)


def test_a_start_is_beside_the_trajectorys() -> None:
    names = "start.x", "start.y", "start.psi", "start_rate.vx", "start_rate.vy"
    spread = {name: 2.0**-k for k, name in enumerate(names)}
    options = run_scenario(made(n=2, spread=spread)).arguments(1).options
    at = TRAJECTORY(0.0)
    offset = np.concatenate([options["q0"] - at.q, options["v0"] - at.v])
    np.testing.assert_allclose(offset, [1, 0.5, 0.25, 0.125, 0.0625, 0], rtol=0, atol=1e-15)


def test_gains_of_coordinates_leave_those_that_couple_them() -> None:
    coupled, spread = np.array([[4.0, 1, 0], [0, 5, 0], [0, 2, 6]]), {"kp.x": 7.0, "kp.y": 8.0, "kp.psi": 9.0}
    run = run_scenario(made(n=2, spread=spread, controller=pm.PD(coupled, 4)))
    controller: Any = run.arguments(1).controller
    np.testing.assert_array_equal(controller.kp, [[7, 1, 0], [0, 8, 0], [0, 2, 9]])


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"n": -3}, "n is -3, expected a whole number >= 1"),
        ({"n": 10**11}, "the records of 100,000,000,000 robots take"),
        ({"controller": pm.InputSaturation(pm.PD(4, 4), [1, 2])}, "limits has shape (2,), expected ()"),
        ({"robot": WITH_ARM}, "q0 has shape (9,), expected (..., 3); the reference has the first 3 of 9"),
        ({"controller": pm.ComputedTorque(WITH_ARM)}, ", which has 9 coordinates, expected 3, "),
        ({"spread": 3}, "spread is 3, expected a mapping of parameters to distributions"),
        ({"spread": {"masss": 3}}, "unknown parameter in spread 'masss', did you mean 'mass'? available"),
        ({"spread": {"mass": "3"}}, "spread['mass'] is '3', expected numbers or a distribution"),
        ({"spread": {"mass": np.ones(3)}}, "spread['mass'] has shape (3,), expected () or (1000,)"),
        (
            {"spread": {"mass": pm.SameAs("controller.mass"), "controller.mass": pm.SameAs("mass")}},
            "spread is circular (mass, controller.mass, mass): give one its own distribution",
        ),
        (
            {"controller": pm.law(lambda t, q, v, reference: -q), "spread": {"kp": 3}},
            "unknown parameter in spread 'kp', available: mass, yaw_inertia, ",
        ),
        ({"after": 1.1}, "after is 1.1 s, expected 0 <= after <= 1 s"),
        ({"dt": 0.3, "duration": 1.0}, "duration is 1.0 s, expected a whole number of steps dt = 0.3 s"),
        ({"controller": pm.PD}, "expected an object: PD(...)"),
        ({"controller": DELAYED, "spread": {"samples": 3}}, "spread has 'samples', a whole number"),
        ({"spread": {"mass": pm.Uniform(20, 30), "plant.mass": 25}}, "which both mean plant.mass"),
        ({"spread": {"com": pm.Uniform(-0.03, 0.03)}}, "of 3 different numbers, expected 'com.x', 'com.y'"),
    ],
)
def test_a_scenario_checks_itself(changes: Any, text: str) -> None:
    error = UnknownName if text.startswith("unknown") else pm.InvalidArgument
    with pytest.raises(error, match=re.escape(text)):
        made(**changes)


@pytest.mark.parametrize(
    ("spread", "text"),
    [
        ({"mass": pm.Normal(5, 5)}, "kg as the mass of the robot, and 172 of 1000 draws (17.20%)"),
        ({"controller.mass": pm.SameAs("mass", -1.0)}, "spread['controller.mass'] gives -30 kg as the mass"),
        ({"mass": stats.uniform(-5, 20)}, "reaches -5 kg as the mass of the robot, and 25.00% of its draws"),
    ],
)
def test_impossible_draws_are_refused_with_their_share(spread: Any, text: str) -> None:
    with refused(re.escape(text)):
        run_scenario(made(spread=spread, forces=[pm.ViscousFriction((0, 0, 0))]))


POSITIVE = {"radius", "controller.yaw_inertia"}
MAY_VANISH = {"viscous", "coefficients.left"}
FREE = {"at.x", "start.x"}


@pytest.mark.parametrize("name", sorted(POSITIVE | MAY_VANISH | FREE))
def test_what_must_not_be_negative_is_refused_below_zero_and_what_must_be_positive_at_zero(name: str) -> None:
    for value, wrong in ((-1e-9, POSITIVE | MAY_VANISH), (0.0, POSITIVE), (1e-9, set())):
        scenario = made(n=1, spread={name: value}, forces=FORCED)
        if name in wrong:
            sign = ">=" if name in MAY_VANISH else ">"
            with refused(rf"spread\['{re.escape(name)}'\] gives .*; expected {sign} 0$"):
                scenario.draws()
        else:
            assert scenario.draws()[name].tolist() == [value]


def test_a_distribution_that_gives_no_numbers_is_refused() -> None:
    class Broken:
        def __init__(self, values: Any) -> None:
            self.values = values

        def sample(self, generator: Any, size: int) -> Any:
            return self.values

    with refused(r"sample has shape \(2,\), expected \(4096,\)"):
        run_scenario(made(spread={"mass": Broken([1.0, 2.0])}))
    with refused(r"spread\['mass'\].sample is nan, expected a finite number"):
        run_scenario(made(spread={"mass": Broken(np.nan)}))


test_distributions_and_options_of_a_run_are_checked = refusals(
    (lambda: pm.Uniform(2, 1), "low is 2.0, expected at most high, 1.0"),
    (lambda: pm.SameAs(3), "name is 3, expected the name of a parameter"),  # type: ignore[arg-type]
    (lambda: run_scenario(made(), progress=3), "progress is 3, expected a function of done and n"),  # type: ignore[arg-type]
    (lambda: run_scenario(made(), traces=[1000]), "traces is 1000, expected at most 999"),
)


def test_a_share_of_whole_robots_is_that_many() -> None:
    n = 100
    # 0.07 * 100 = 7.000000000000001, and the seventh of a hundred is meant.
    run = run_scenario(made(n=n, spread={"mass": pm.Uniform(20, 40)}))
    distance, heading = np.sort(run.max_distance), np.sort(run.max_error[:, 2])
    for k in range(1, n + 1):
        assert run.error_quantile(k / n) == ErrorQuantile(
            {"distance": distance[k - 1], "heading": heading[k - 1]}
        )
    assert run.error_quantile(0) == ErrorQuantile({"distance": distance[0], "heading": heading[0]})
    # In bins too: seven apart from the rest.
    apart = np.concatenate([np.full(7, 0.001), np.full(93, 1.0)])
    counts = np.bincount(bins_of(apart), minlength=BINS)
    assert quantiles(counts, np.array([0.07]))[0] == pytest.approx(0.001, rel=2**-5)


def test_an_ensemble_says_what_came_of_it() -> None:
    run = run_scenario(made(spread={"mass": pm.Uniform(20, 40)}, duration=60.0))
    text = str(run)
    assert "1,000 robots over 60 s: 99 % stay within" in text
    assert "none diverged" in text
    assert f"{np.median(run.max_distance):.4g}" in text
    assert len(run) == 1000
    assert run.error_quantile(1.0).distance == run.max_distance.max()
    assert run.error_quantile(0.5).heading == np.sort(run.max_error[:, 2])[499]
    bands = run.bands()
    assert bands.distance.shape == (3, 61)
    assert (np.diff(bands.distance, axis=0) >= 0).all()
    assert bands.distance[-1].max() == pytest.approx(run.error_quantile(0.99).distance, rel=2**-5)
    for share in (-0.1, 1.1, np.nan, [0.5, 0.9]):
        with refused("share"):
            run.error_quantile(share)  # type: ignore[arg-type]
    for levels in (-0.1, [], [2.0]):
        with refused("levels"):
            run.bands(levels)


def test_rows_of_an_ensemble_leave_out_robots_that_diverged() -> None:
    law, gains = pm.PD((120, 120, 12), (120, 120, 12)), np.array([10.0, 100.0, 1e6])
    run = run_scenario(made(controller=law, n=3, spread={"kp": gains}, dt=0.05))
    lines = str(run).splitlines()
    low, high = sorted(run.max_distance[:2])
    row = lines[lines.index("the 2 robots that did not diverge:") + 1]
    assert f"least {low:.4g}, median {(low + high) / 2:.4g}, largest {high:.4g}" in row


def test_what_came_of_an_ensemble_cannot_be_overwritten() -> None:
    run = run_scenario(made(n=3, spread={"mass": pm.Uniform(20, 40)}))
    records = [run.max_error, run.rms_error, run.max_distance, run.max_input, run.diverged_at, run.counts]
    held: list[Any] = [*records, *run.draws.values()]
    for array in held:
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1


def test_a_robot_that_is_not_there_is_no_member() -> None:
    run = run_scenario(made(n=3))
    for i in (3, -1):
        for ask in (run.member, run.arguments):
            with refused(rf"^i is {i}, expected "):
                ask(i)
    assert run.arguments(2).robot.mass == 30
