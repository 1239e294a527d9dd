"""Every route to M, n, tau and the acceleration side by side, with the largest difference."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from pinmobile import closed_form
from pinmobile.arrays import Array, whole
from pinmobile.derivation import Numeric, lagrange, lecture
from pinmobile.dh import DHTable
from pinmobile.errors import InvalidArgument
from pinmobile.robot import MobileRobot

__all__ = ["Comparison", "Verification", "verify"]

_EPS = float(np.finfo(np.float64).eps)
_TOLERANCE = 1e-12  # some thousand roundings, relative to the scale of the terms

Dynamics = dict[str, Array]


@dataclass(frozen=True)
class Comparison:
    """The largest difference of one quantity between two routes.

    Attributes
    ----------
    quantity : str
        ``"M"``, ``"n"``, ``"tau"`` or ``"a"``.
    route, against : str
        The two routes.
    difference : float
        Largest difference over all states, relative to the scale of the terms.
    bound : float
        Largest difference that rounding explains.
    """

    quantity: str
    route: str
    against: str
    difference: float
    bound: float

    @property
    def agrees(self) -> bool:
        """Whether the difference is within the bound."""
        return self.difference <= self.bound


@dataclass(frozen=True)
class Verification:
    """All comparisons for one robot; printed, it is a table.

    Attributes
    ----------
    robot : MobileRobot
        What was verified.
    states : int
        Number of random states.
    rows : tuple of Comparison
        One per quantity and route.
    """

    robot: MobileRobot
    states: int
    rows: tuple[Comparison, ...]

    @property
    def passed(self) -> bool:
        """Whether every comparison agrees."""
        return all(row.agrees for row in self.rows)

    @property
    def largest(self) -> dict[str, float]:
        """Largest difference of each quantity over the routes."""
        quantities = dict.fromkeys(row.quantity for row in self.rows)
        return {q: max(row.difference for row in self.rows if row.quantity == q) for q in quantities}

    def __str__(self) -> str:
        head = f"{'':3} {'route':32} {'largest difference':>18} {'bound':>9}"
        lines = [
            f"{row.quantity:3} {row.route:32} {row.difference:18.1e} {row.bound:9.1e}  "
            f"{'agrees' if row.agrees else 'DIFFERS'}"
            for row in self.rows
        ]
        against = self.rows[0].against
        return "\n".join([f"{self.states} random states, each route against the {against}", head, *lines])


def verify(robot: MobileRobot, *, states: int = 200, seed: int | np.random.Generator = 0) -> Verification:
    """Compare every route to the robot's dynamics on random states.

    The routes are the closed form (hand-derived), Pinocchio (CRBA, RNEA, ABA), the symbolic Newton-Euler
    recursion and Lagrange's equations, the last two for the robot's own DH table. Differences are relative
    to the scale of the terms: sqrt(M_ii M_jj) for M, m |v|^2 for n, |M| |a| + m |v|^2 for tau and |a| + |v|^2
    for the acceleration; |v|^2 times the distance of the centre of mass where that is above 1 m. The first
    three must be within 1e-12, the last within 8 eps cond(M).

    Parameters
    ----------
    robot : MobileRobot
        Any mass, inertia, centre of mass and table.
    states : int
        Number of states: psi over two turns to either side, v and a normal with unit deviation.
    seed : int or Generator
        Of the states.

    Returns
    -------
    verification : Verification
        Print it; ask `passed` and `largest`.

    Raises
    ------
    InvalidArgument
        If `states` is not a whole number >= 1.
    """
    if not isinstance(robot, MobileRobot):
        raise InvalidArgument(f"robot is {robot!r}, expected a MobileRobot")
    rng = np.random.default_rng(seed)
    shape = (whole("states", states), 3)
    q = rng.uniform(-4 * np.pi, 4 * np.pi, shape)
    v, a = rng.normal(size=shape), rng.normal(size=shape)
    truth = _closed_form(robot, q, v, a)
    tau = truth["tau"]
    scales = _scales(robot, truth, v, a)
    routes: dict[str, Callable[..., Dynamics]] = {
        "Pinocchio (CRBA, RNEA, ABA)": _pinocchio,
        "symbolic Newton-Euler": _newton_euler,
        "symbolic Lagrange": _lagrange,
    }
    found = {name: route(robot, q, v, a, tau) for name, route in routes.items()}
    bounds = dict.fromkeys(("M", "n", "tau"), _TOLERANCE)
    rows = []
    for quantity, scale in scales.items():
        for name, dynamics in found.items():
            relative = float((np.abs(dynamics[quantity] - truth[quantity]) / scale).max())
            bound = bounds.get(quantity, 8 * _EPS * float(np.linalg.cond(truth["M"]).max()))
            rows.append(Comparison(quantity, name, "closed form", relative, bound))
    return Verification(robot, shape[0], tuple(rows))


def _scales(robot: MobileRobot, truth: Dynamics, v: Array, a: Array) -> Dynamics:
    M = truth["M"]
    diagonal = np.sqrt(np.einsum("...ii->...i", M))
    reach = max(1.0, float(np.linalg.norm(robot.com[:2])))  # the centre of mass goes this much faster
    speed = robot.mass * np.square(v).sum(-1, keepdims=True) * reach
    return {
        "M": diagonal[..., :, None] * diagonal[..., None, :],
        "n": speed,
        "tau": np.einsum("...ij,...j->...i", np.abs(M), np.abs(a)) + speed,
        "a": np.linalg.norm(truth["a"], axis=-1, keepdims=True) + speed / robot.mass,
    }


def _closed_form(robot: MobileRobot, q: Array, v: Array, a: Array) -> Dynamics:
    mass, inertia, com = robot.mass, robot.yaw_inertia, robot.com[:2]
    tau = closed_form.inverse_dynamics(q, v, a, mass=mass, yaw_inertia=inertia, com=com)
    return {
        "M": closed_form.mass_matrix(q, mass=mass, yaw_inertia=inertia, com=com),
        "n": closed_form.nonlinear_effects(q, v, mass=mass, com=com),
        "tau": tau,
        "a": closed_form.forward_dynamics(q, v, tau, mass=mass, yaw_inertia=inertia, com=com),
    }


def _pinocchio(robot: MobileRobot, q: Array, v: Array, a: Array, tau: Array) -> Dynamics:
    return {
        "M": robot.mass_matrix(q),
        "n": robot.nonlinear_effects(q, v),
        "tau": robot.inverse_dynamics(q, v, a),
        "a": robot.forward_dynamics(q, v, tau),
    }


def _newton_euler(robot: MobileRobot, q: Array, v: Array, a: Array, tau: Array) -> Dynamics:
    return _symbolic(_numeric(robot.dh)[0], robot, q, v, a, tau)


def _lagrange(robot: MobileRobot, q: Array, v: Array, a: Array, tau: Array) -> Dynamics:
    return _symbolic(_numeric(robot.dh)[1], robot, q, v, a, tau)


@lru_cache(maxsize=8)
def _numeric(table: DHTable) -> tuple[Numeric, Numeric]:
    """Return the functions that Newton-Euler and Lagrange lead to for a table."""
    derivation = lecture(table)
    return derivation.numeric(), lagrange(derivation).numeric()


def _symbolic(numeric: Numeric, robot: MobileRobot, q: Array, v: Array, a: Array, tau: Array) -> Dynamics:
    parameters = {"m": robot.mass, "Icz": robot.yaw_inertia, "xbc": robot.com[0], "ybc": robot.com[1]}
    M, n = numeric.mass_matrix(q, parameters), numeric.nonlinear_effects(q, v, parameters)
    return {
        "M": M,
        "n": n,
        "tau": numeric.inverse_dynamics(q, v, a, parameters),
        "a": _solved(M, tau - n),
    }


def _solved(M: Array, force: Array) -> Array:
    """Return M^-1 force; not a number where M is singular to rounding, which then agrees with nothing."""
    try:
        return np.asarray(np.linalg.solve(M, force[..., None])[..., 0], np.float64)
    except np.linalg.LinAlgError:
        return np.full(force.shape, np.nan)
