"""A bare body: closed form, Pinocchio, the two symbolic derivations, and machine code."""

from collections.abc import Callable
from functools import lru_cache

import numpy as np

from pinmobile import closed_form
from pinmobile.arrays import Array
from pinmobile.derivation import Numeric, lagrange, lecture
from pinmobile.dh import DHTable
from pinmobile.robot import MobileRobot
from pinmobile.verification.routes import COMPILED, Dynamics, by_machine_code, by_pinocchio
from pinmobile.verification.table import Comparison

__all__ = ["compare_planar"]

_EPS = float(np.finfo(np.float64).eps)
_TOLERANCE = 1e-12  # some thousand roundings, relative to the scale of the terms


def compare_planar(robot: MobileRobot, states: int, rng: np.random.Generator) -> tuple[Comparison, ...]:
    """Return every route of a bare body against the closed form, see `verify`."""
    shape = (states, 3)
    q = rng.uniform(-4 * np.pi, 4 * np.pi, shape)
    v, a = rng.normal(size=shape), rng.normal(size=shape)
    truth = _closed_form(robot, q, v, a)
    tau = truth["tau"]
    scales = _scales(robot, truth, v, a)
    routes: dict[str, Callable[..., Dynamics]] = {
        "Pinocchio (CRBA, RNEA, ABA)": by_pinocchio,
        "symbolic Newton-Euler": _newton_euler,
        "symbolic Lagrange": _lagrange,
        COMPILED: by_machine_code,
    }
    found = {name: route(robot, q, v, a, tau) for name, route in routes.items()}
    bounds = dict.fromkeys(("M", "n", "tau"), _TOLERANCE)
    rows = []
    for quantity, scale in scales.items():
        for name, dynamics in found.items():
            relative = float((np.abs(dynamics[quantity] - truth[quantity]) / scale).max())
            bound = bounds.get(quantity, 8 * _EPS * float(np.linalg.cond(truth["M"]).max()))
            rows.append(Comparison(quantity, name, "closed form", relative, bound))
    return tuple(rows)


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
