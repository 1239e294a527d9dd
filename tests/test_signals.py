"""Signals: what any part of a loop tells beside states and inputs, the same in every engine."""

import csv
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pinmobile as pm
from pinmobile import plots
from tests.parts import PID, Axle, Cart, CartCircle, Eight, Follower, Nodding, Smoothed, Spring

ROBOT = pm.MobileRobot(30.0, 1.3, com=(0.1, 0.05))
BODY: Any = (Nodding(Eight()), {"dt": 0.02, "duration": 3.0})
FOLLOWER: Any = Follower()
CART: Any = (CartCircle(), {"dt": 0.02, "duration": 3.0})


class TellingPID(PID):
    def signals(self, state: Any) -> Any:
        return {"integral": ("N", state["sum"]), "applied": ("N", state["u"][0])}


class TellingSpring(Spring):
    def signals(self, t: float, pose: Any, rate: Any) -> Any:
        return {"pull": ("N", self(t, pose, rate)[:2]), "sine": ("", np.sin(t))}


class TellingAxle(Axle):
    def signals(self, t: float, q: Any, v: Any) -> Any:
        return {"axle torque": ("N m", self.on_coordinates(t, q, v)[3])}


class TellingCart(Cart):
    def signals(self, t: float, q: Any, v: Any, u: Any, f: Any, memory: Any) -> Any:
        return {"pushed": ("N", f), "power": ("W", [u[0] * v[3], u[1] * v[4]]), "wheels": ("", 2)}


class TellingSmoothed(Smoothed):
    def signals(self, state: Any) -> Any:
        return {"smooth": ("N", state[1]), **self.controller.signals(state[0])}


WRAPPED = pm.MeasurementNoise(pm.MeasurementDelay(pm.InputSaturation(TellingPID(), 40.0), 2), 1e-3, 1e-3, 5)


@pytest.mark.parametrize(
    ("plant", "controller", "where", "forces", "units"),
    [
        (ROBOT, WRAPPED, BODY, [TellingSpring()], {"integral": "N", "applied": "N", "pull": "N", "sine": ""}),
        (ROBOT, TellingSmoothed(WRAPPED), BODY, [], {"smooth": "N", "integral": "N", "applied": "N"}),
        (
            TellingCart(),
            Follower(),
            CART,
            [Spring(), TellingAxle()],
            {"pushed": "N", "power": "W", "wheels": "", "axle torque": "N m"},
        ),
    ],
)
def test_engines_agree(plant: Any, controller: Any, where: Any, forces: Any, units: dict[str, str]) -> None:
    trajectory, options = where
    runs = [
        pm.simulate(plant, controller, trajectory, forces=forces, engine=engine, **options)
        for engine in (pm.Engine.PYTHON, pm.Engine.COMPILED)
    ]
    for run in runs:
        assert {name: signal.unit for name, signal in run.signals.items()} == units
    for name in units:
        one, other = (run.signals[name].values for run in runs)
        assert one.shape == other.shape
        assert not other.flags.writeable
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-12 * np.abs(one).max())


def test_they_are_what_the_laws_say() -> None:
    run = pm.simulate(
        TellingCart(), FOLLOWER, CART[0], forces=[TellingAxle()], engine=pm.Engine.COMPILED, **CART[1]
    )
    np.testing.assert_allclose(run.signals["power"].values, run.u * run.v[:, 3:], rtol=1e-14)
    np.testing.assert_allclose(run.signals["axle torque"].values, -0.02 * run.v[:, 3], rtol=1e-14)
    np.testing.assert_array_equal(run.signals["pushed"].values[:, 3], run.signals["axle torque"].values)
    told = pm.simulate(
        ROBOT, pm.InputSaturation(TellingPID(), 15.0), BODY[0], engine=pm.Engine.COMPILED, **BODY[1]
    )
    assert np.abs(told.u).max() == 15.0
    assert np.abs(told.signals["applied"].values).max() > 15.0  # what it asked for


class Claiming(TellingSpring):
    def signals(self, t: float, pose: Any, rate: Any) -> Any:
        return {"applied": ("N", 1.0)}


class Branching(TellingPID):
    def signals(self, state: Any) -> Any:
        return {"integral": ("N", 1.0 if state["sum"][0] > 0 else 0.0)}


@pytest.mark.parametrize("engine", [pm.Engine.PYTHON, pm.Engine.COMPILED])
def test_a_name_that_two_parts_claim_is_refused(engine: Any) -> None:
    controller = pm.InputSaturation(TellingPID(), 9.0)
    with pytest.raises(pm.InvalidArgument, match=r"controller and forces\[0\] both have the signal '"):
        pm.simulate(ROBOT, controller, BODY[0], forces=[Claiming()], engine=engine, **BODY[1])


def test_signals_that_cannot_be_compiled_are_told_with_their_line() -> None:
    with pytest.raises(pm.InvalidArgument, match=r"^engine is Engine.COMPILED, .*Branching.signals, line"):
        pm.simulate(ROBOT, Branching(), BODY[0], engine=pm.Engine.COMPILED, **BODY[1])
    # An ensemble keeps no signals, and asks for none.
    assert pm.ensemble(ROBOT, Branching(), BODY[0], n=2, spread={}, **BODY[1]).engine == "COMPILED"


def test_files_and_figures_have_their_names_and_units(tmp_path: Path) -> None:
    run = pm.simulate(ROBOT, WRAPPED, BODY[0], forces=[TellingSpring()], engine=pm.Engine.COMPILED, **BODY[1])
    run.save(tmp_path / "run.npz")
    kept = pm.Rollout.load(tmp_path / "run.npz")
    for name, (unit, values) in run.signals.items():
        assert kept.signals[name].unit == unit
        np.testing.assert_array_equal(kept.signals[name].values, values)
    run.to_csv(tmp_path / "run.csv")
    with (tmp_path / "run.csv").open(newline="") as file:
        header, *rows = list(csv.reader(file))
    assert header[:5] == ["t [s]", "x [m]", "y [m]", "psi [rad]", "v_x [m/s]"]
    np.testing.assert_array_equal(np.array(rows, float)[:, 3], run.q[:, 2])
    assert header[-7:] == [
        *(f"signal_integral[{k}] [N]" for k in range(3)),
        "signal_applied [N]",
        *(f"signal_pull[{k}] [N]" for k in range(2)),
        "signal_sine",
    ]
    np.testing.assert_array_equal(np.array(rows, float)[:, -3:-1], run.signals["pull"].values)
    labels = [axes.get_ylabel() for axes in plots.signals(kept).axes]
    assert labels == ["integral [N]", "applied [N]", "pull [N]", "sine"]
