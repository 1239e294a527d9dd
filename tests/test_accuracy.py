"""Order, drift and the cost of a held force, measured of each integrator and of some made to fail."""

from typing import Any

import numpy as np
import pytest
from matplotlib.colors import to_hex

from pinmobile import MobileRobot, plots, rk4
from pinmobile.accuracy import Convergence, IntegratorReport, integrator_report, invariants
from pinmobile.arrays import Array
from pinmobile.integrators import constant_acceleration, semi_implicit_euler
from pinmobile.palette import colour
from tests.refusals import begun, refusals

ORDERS = {"constant_acceleration": 1, "semi_implicit_euler": 1, "rk4": 4}
KEPT = ("position", "momentum", "angular_momentum", "energy")


Reports = dict[str, IntegratorReport]


def twice_as_fast(acceleration: Any, t: float, q: Array, v: Array, dt: float) -> tuple[Array, Array]:
    return q + 2 * dt * v, v + dt * acceleration(t, q, v)


def explodes(acceleration: Any, t: float, q: Array, v: Array, dt: float) -> tuple[Array, Array]:
    return q + dt * v, v * 1e9


@pytest.fixture(scope="module")
def reports() -> Reports:
    return {str(i): integrator_report(i) for i in (constant_acceleration, semi_implicit_euler, rk4)}


@pytest.mark.parametrize("name", ORDERS)
def test_invariants_of_the_free_body_are_held_to_the_order_of_the_method(name: str, reports: Reports) -> None:
    """The heading turns uniformly, so v is a quadrature: a left Riemann sum, of order 1, or Simpson's, of 4.

    The position's own sum adds terms of order 1 for Euler's methods; none of them cancels.
    """
    for quantity in KEPT:
        # Next to c h^p, terms of order p + 1 weigh a few per cent at h = 0.1 s.
        assert getattr(reports[name], quantity).order == pytest.approx(ORDERS[name], abs=0.03), quantity
    assert reports[name].heading.exact


@pytest.mark.parametrize("name", ORDERS)
def test_in_the_loop_the_order_is_the_methods_within_a_sample_and_one_over_samples(
    name: str, reports: Reports
) -> None:
    report = reports[name]
    assert report.substeps.order == pytest.approx(ORDERS[name], abs=0.05)
    assert report.sampling.order == pytest.approx(1, abs=0.05)


def test_what_holding_costs_does_not_depend_on_the_integrator(reports: Reports) -> None:
    held = [report.hold_error for report in reports.values()]
    assert max(held) == min(held)
    fine = reports["rk4"]
    # The loop by rk4 is off by what holding costs, and by what rk4 does.
    assert abs(fine.sampling.errors[0] - fine.hold_error) <= fine.substeps.errors[0] + 1e-12


@pytest.mark.parametrize("seed", range(3))
def test_what_is_conserved_is_the_generalised_momentum(seed: int) -> None:
    """M v is the momentum, and that about the body's origin; x p_y - y p_x takes it to the inertial one."""
    rng = np.random.default_rng(seed)
    (q, v), robot = rng.normal(size=(2, 3)), MobileRobot(3.0, 0.7, com=rng.uniform(-1, 1, 2))
    p, now = robot.mass_matrix(q) @ v, invariants(robot, q, v)
    np.testing.assert_allclose(now.momentum, p[:2], rtol=0, atol=1e-12)
    assert now.angular_momentum == pytest.approx(p[2] + q[0] * p[1] - q[1] * p[0], abs=1e-12)
    assert now.energy == pytest.approx(robot.kinetic_energy(q, v), rel=1e-11)


def made(errors: Any, rounding: float = 1e-12) -> Convergence:
    steps: Array = 0.1 * np.power(0.5, np.arange(len(errors)))
    return Convergence("position", "m", steps, np.array(errors, float), np.full(len(errors), rounding))


@pytest.mark.parametrize(
    ("errors", "order", "text"),
    [
        ([8.0, 1.0, 1 / 8], 3, "order 3.00"),
        ([np.inf, 1.0, 0.25, 1 / 16], 2, "order 2.00"),
        ([1e-8, 1e-10, 1e-12, 1e-13], np.log2(100), "order 6.64"),  # the last two are rounding's
        ([1.0, 2.0, 4.0], -1, "does not converge"),
        ([1e-13, 0.0, 1e-12], None, "exact to rounding"),
        ([1e-9, 1e-13, 1e-13], None, "too close to rounding for an order"),
        ([np.inf, np.inf], None, "diverges"),
    ],
)
def test_an_order_is_fitted_above_rounding(errors: Any, order: float | None, text: str) -> None:
    found = made(errors)
    assert found.order == (None if order is None else pytest.approx(order, abs=1e-12))
    assert str(found) == text


def test_the_report_reads_as_a_table_that_says_what_it_means(reports: Reports) -> None:
    lines = str(reports["rk4"]).splitlines()
    assert lines[0] == f"rk4 on {reports['rk4'].robot!r}"
    assert lines[2].startswith("  position at the end [m] ")
    assert lines[2].endswith("   order 4.00")
    assert lines[3].endswith("   exact to rounding")
    assert lines[-3:] == [
        "order p: with half the step, the error is 1 / 2^p.",
        "In the loop, the zero-order hold has order 1 in dt, for every integrator.",
        "At dt = 0.1 s the hold costs 0.0098 m, the integrator 1.2e-07 m: "
        "a shorter dt gains more than a better integrator.",
    ]
    assert str(reports["semi_implicit_euler"]).endswith(
        "At dt = 0.1 s the hold costs 0.0098 m, the integrator 0.014 m: "
        "a better integrator, or substeps, gain more than a shorter dt."
    )
    assert repr(reports["rk4"]) == "<IntegratorReport: rk4, order 4.00 alone, order 1.01 in the loop>"


@pytest.mark.parametrize(
    ("integrator", "text"), [(twice_as_fast, "does not converge"), (explodes, "diverges")]
)
def test_a_step_that_is_wrong_is_told_from_one_that_is_not(integrator: Any, text: str) -> None:
    report = integrator_report(integrator, steps=(0.1, 0.05))
    assert {str(row) for row in (*report.free, report.substeps, report.sampling)} == {text}
    assert str(report).endswith(
        "The integrator does not converge: it solves another equation, or the steps are too long."
    )


test_arguments_that_do_not_fit_are_refused = refusals(
    (lambda: integrator_report(rk4, steps=(0.1, 0.2)), "steps are [0.1, 0.2] s, expected steps > 0, the "),
    (lambda: integrator_report(rk4, steps=(0.3, 0.1)), "duration is 2.0 s, expected a whole multiple of "),
    (lambda: integrator_report(rk4, steps=(0.1, 0.03)), "steps[0] is 0.1 s, expected a whole multiple of"),
    by=begun,
)


# Figure


def test_lines_are_the_errors_in_milliseconds_and_notes_the_orders(reports: Reports) -> None:
    figure = plots.integrator(reports)
    assert [axes.get_ylabel() for axes in figure.axes] == [
        "error [m]", "relative drift", "error [m]", "relative drift", "relative drift", "error [m]"
    ]  # fmt: skip
    loop = figure.axes[5]
    for index, (name, report) in enumerate(reports.items()):
        line = loop.lines[index]
        np.testing.assert_allclose(np.asarray(line.get_xdata(), float), 1e3 * report.sampling.steps)
        np.testing.assert_array_equal(line.get_ydata(), report.sampling.errors)
        assert to_hex(line.get_color()).upper() == colour(index)
        note = loop.texts[index]
        assert note.get_text() == f"{name}: {report.sampling}"
        assert str(note.get_color()) == colour(index)
    assert [text.get_text() for text in figure.axes[0].texts[3:]] == ["$h$", "$h^4$"]
    assert (loop.get_xscale(), loop.get_yscale()) == ("log", "log")
    assert loop.get_xlabel() == "step h [ms]"


def test_a_guide_has_the_slope_that_it_says(reports: Reports) -> None:
    figure = plots.integrator(reports["rk4"])
    assert figure.texts[0].get_text() == "Accuracy of rk4: error over the step"
    guide = figure.axes[0].lines[1].get_xydata()
    (x0, y0), (x1, y1) = np.log(np.asarray(guide))
    assert (y1 - y0) / (x1 - x0) == pytest.approx(4)
