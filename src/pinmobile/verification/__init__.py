"""Comparison of independent methods for M, n, tau and the acceleration, with the largest difference."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import Any

import numpy as np

from pinmobile import closed_form
from pinmobile.arrays import Array, check_integer, instance, seeded
from pinmobile.compiled import vectorize
from pinmobile.derivation import Numeric, lagrange, lecture
from pinmobile.dh import DHTable
from pinmobile.errors import NotTraceable
from pinmobile.robot import MobileRobot
from pinmobile.verification._wheels import Row, compare_wheeled
from pinmobile.verification.bodies import Parts, apply, composite_body, max_ratio
from pinmobile.wheels import WheeledRobot

__all__ = ["Comparison", "Verification", "verify"]

_MAX_STATES = 1_000_000  # states


@dataclass(frozen=True)
class Comparison:
    """Largest difference of one quantity between two methods.

    Attributes
    ----------
    quantity : str
        ``"M"``, ``"n"``, ``"tau"`` or ``"a"``. A robot with arms adds ``"M3"``, the block of the base in M,
        and ``"f"``, the wrench of the ground. For a robot on wheels, see `verify`.
    method, against : str
        Names of the two methods.
    difference : float
        Largest difference over all states, relative to the scale of the terms.
    bound : float
        Largest relative difference that rounding explains.

    See Also
    --------
    verify : function that makes all comparisons

    Examples
    --------
    >>> from pinmobile.verification import Comparison
    >>> row = Comparison("M", "CRBA", "closed form", 3e-16, 1e-12)
    >>> row.agrees
    True
    """

    quantity: str
    method: str
    against: str
    difference: float
    bound: float

    @property
    def agrees(self) -> bool:
        """Whether the difference is within the bound."""
        return self.difference <= self.bound


@dataclass(frozen=True)
class Verification:
    """Comparisons of all methods for one robot; its text is a table.

    Attributes
    ----------
    robot : MobileRobot or WheeledRobot
        Verified robot.
    states : int
        Number of random states.
    rows : tuple of Comparison
        One comparison per quantity and method.
    missing : str
        Name of a method that is not available, and the reason; empty if all methods are available.

    See Also
    --------
    verify : function that returns this object

    Examples
    --------
    >>> from pinmobile import MobileRobot
    >>> from pinmobile.verification import Comparison, Verification
    >>> row = Comparison("M", "CRBA", "closed form", 3e-16, 1e-12)
    >>> print(Verification(MobileRobot.lecture(), 1, (row,)))
    1 random states, each method against the closed form
        method                           largest difference     bound
    M   CRBA                                        3.0e-16   1.0e-12  agrees
    """

    robot: MobileRobot | WheeledRobot
    states: int
    rows: tuple[Comparison, ...]
    missing: str = ""

    @property
    def passed(self) -> bool:
        """Whether every difference is within its bound."""
        return all(row.agrees for row in self.rows)

    @property
    def largest(self) -> dict[str, float]:
        """Largest relative difference of each quantity over all methods."""
        quantities = dict.fromkeys(row.quantity for row in self.rows)
        return {q: max(row.difference for row in self.rows if row.quantity == q) for q in quantities}

    def __str__(self) -> str:
        references = {row.against for row in self.rows}
        names = [row.method if len(references) == 1 else f"{row.method} / {row.against}" for row in self.rows]
        width = max(32, *map(len, names))
        first = max(3, *(len(row.quantity) for row in self.rows))
        head = f"{'':{first}} {'method':{width}} {'largest difference':>18} {'bound':>9}"
        lines = [
            f"{row.quantity:{first}} {name:{width}} {row.difference:18.1e} {row.bound:9.1e}  "
            f"{'agrees' if row.agrees else 'DIFFERS'}"
            for name, row in zip(names, self.rows, strict=True)
        ]
        reference = f"the {references.pop()}" if len(references) == 1 else "another"
        omitted = [f"left out, {self.missing}"] if self.missing else []
        return "\n".join(
            [f"{self.states} random states, each method against {reference}", head, *lines, *omitted]
        )


def verify(
    robot: MobileRobot | WheeledRobot, *, states: int = 200, seed: int | np.random.Generator = 0
) -> Verification:
    r"""Compare independent methods for a robot's dynamics at random states.

    Parameters
    ----------
    robot : MobileRobot or WheeledRobot
        Robot with any mass, inertia, centre of mass and DH table, any arms and loads, any wheels.
    states : int
        Number of states, 1 to 1,000,000. psi is within two turns, arms are within their limits, v and a are
        normally distributed with unit standard deviation.
    seed : int or Generator
        Seed or generator of the states.

    Returns
    -------
    verification.Verification
        All differences and their bounds; its text is a table.

    Raises
    ------
    InvalidArgument
        If `states` is not a whole number from 1 to 1,000,000, or another argument is not what is expected.

    See Also
    --------
    derivation.lecture : symbolic derivation of the dynamics
    closed_form.mass_matrix : formulas derived by hand
    verification.Verification : result of this function

    Notes
    -----
    **A robot without arms, loads and wheels.** The methods are the closed form (derived by hand),
    Pinocchio (CRBA, RNEA, ABA), the symbolic Newton-Euler recursion and Lagrange's equations for the robot's
    DH table, and the machine code that ensembles run. Differences are relative to the scale of the terms:
    sqrt(M_ii M_jj) for M, :math:`m |v|^2` for n, :math:`|M| |a| + m |v|^2` for tau and :math:`|a| + |v|^2`
    for the acceleration. The factor of the squared velocity includes the distance of the centre of mass if it
    exceeds 1 m. The bounds are 1e-12 for M, n and tau, and 8 eps cond(M) for the acceleration.

    **A robot with arms or loads.** Newton's and Euler's laws, written out for the separate parts (body, arms
    as read from their files, loads), check M by CRBA and n, tau and the ground's wrench f by RNEA. This check
    does not use the assembled model. Further comparisons are: M with RNEA's columns; n with C(q, v) v + g(q);
    tau with M a + n; the acceleration by ABA with M^-1 (tau - n); M[:3, :3] with the closed form of the body
    with locked arms; and the machine code of ensembles with CRBA, RNEA and ABA. If there is no machine code,
    `Verification.missing` gives the reason. Let m be the mass beyond a joint, K its second moment about the
    joint (m for a prismatic joint) and r the largest distance of a part [m], at least 1. The scales are
    sqrt(K_i K_j) for M, :math:`\sqrt{m K} (9.81 + n_v r |v|^2)` for n, :math:`\sqrt{m K} (9.81 + \sqrt{n_v} r
    |a| + n_v r |v|^2)` for tau, the same for x and psi for the forces and moments of f, and :math:`|M^{-1}|`
    times this for the acceleration. Gravity in RNEA's columns adds 9.81 sqrt(m K) to the scale of M. All
    bounds are 1e-14.

    **A robot on rolling wheels**, at random states that satisfy the rolling constraints. Newton's and Euler's
    laws of body, arms and each wheel check M by CRBA and n by RNEA of the tree with wheels as joints, and the
    torques for given accelerations and the constraint forces by a KKT system. The planar terms of the wheels'
    energy check the acceleration and the ground's forces, as numbers and as machine code. M, n and B of the
    independent velocities nu agree with the tree, and with a closed form for two fixed wheels on an axle,
    fixed wheels with rollers, and a car (with arms: only M, with locked arms). nu' agrees with the rate of nu
    under the KKT accelerations. The power of inputs, forces and gravity agrees with the rate of kinetic
    energy. For wheels that slip, the comparison uses a step of 1 ms, iterated to convergence: the same laws
    check its forces, its loads and its power at mid-step, and forces are at most mu times the load. Scales
    are as above; those of a wheel have K, its inertia about the axle, and m, its mass and K / r^2, and
    include the acting forces. The bounds are 1e-13, 1e-12 for solutions of linear equations, and 1e-9 for
    rates by finite differences of fourth order.

    Examples
    --------
    >>> from pinmobile import MobileRobot, verify
    >>> robot = MobileRobot.box().mount("double_pendulum_simple")
    >>> found = verify(robot, states=5)
    >>> found.passed, found.largest["M"] < 1e-14
    (True, True)
    """
    instance("robot", robot, MobileRobot | WheeledRobot, "a MobileRobot or a WheeledRobot")
    rng, count = seeded("seed", seed), check_integer("states", states, most=_MAX_STATES)
    compare: Any = compare_wheeled
    if isinstance(robot, MobileRobot):
        compare = compare_mounted if robot.mounts or robot.loads else compare_planar
    rows, missing = compare(robot, count, rng)
    return Verification(robot, count, tuple(Comparison(*row) for row in rows), missing)


Dynamics = dict[str, Array]
"""M, n, tau for an acceleration, and a for a force, at n states, by name."""

COMPILED = "compiled for ensembles"


def stack_values(function: Callable[..., Array], *states: Array) -> Array:
    """Return the values of a function, state by state, since arrays of states may run machine code."""
    return np.stack([function(*state) for state in zip(*states, strict=True)])


def pinocchio_dynamics(robot: MobileRobot, q: Array, v: Array, a: Array, tau: Array) -> Dynamics:
    """Return the dynamics by CRBA, RNEA and ABA."""
    return {
        "M": stack_values(robot.mass_matrix, q),
        "n": stack_values(robot.nonlinear_effects, q, v),
        "tau": stack_values(robot.inverse_dynamics, q, v, a),
        "a": stack_values(robot.forward_dynamics, q, v, tau),
    }


def compiled_dynamics(robot: MobileRobot, q: Array, v: Array, a: Array, tau: Array) -> Dynamics:
    """Return the dynamics by the compiled code of ensembles.

    Raises
    ------
    NotTraceable
        If the dynamics cannot be compiled: a joint has several coordinates, or there are too many joints.
    """
    values = vectorize(partial(_dynamics, robot.array_dynamics), keep=False)(q, v, a, tau)
    return dict(zip(("M", "n", "tau", "a"), values, strict=True))


def _try_compiled(robot: MobileRobot, *states: Array) -> tuple[dict[str, Dynamics], str]:
    """Return the dynamics by machine code under the name of this method, and the reason if there is none."""
    try:
        return {COMPILED: compiled_dynamics(robot, *states)}, ""
    except NotTraceable as error:
        return {}, f"{COMPILED}: {error.reason}"


def _dynamics(body: Any, q: Array, v: Array, a: Array, tau: Array) -> tuple[Array, ...]:
    return (
        body.mass_matrix(q),
        body.nonlinear_effects(q, v),
        body.inverse_dynamics(q, v, a),
        body.forward_dynamics(q, v, tau),
    )


_EPS = float(np.finfo(np.float64).eps)
_TOLERANCE = 1e-12  # thousands of roundings, relative to the scale of the terms


def compare_planar(robot: MobileRobot, states: int, rng: np.random.Generator) -> tuple[list[Row], str]:
    """Return the comparisons with the closed form for a robot without arms, and a missing method."""
    shape = (states, 3)
    q = rng.uniform(-4 * np.pi, 4 * np.pi, shape)
    v, a = rng.normal(size=shape), rng.normal(size=shape)
    truth = _closed_form(robot, q, v, a)
    tau = truth["tau"]
    methods = {"Pinocchio (CRBA, RNEA, ABA)": pinocchio_dynamics(robot, q, v, a, tau)}
    for name, numeric in zip(("Newton-Euler", "Lagrange"), _numeric(robot.dh), strict=True):
        methods[f"symbolic {name}"] = _symbolic(numeric, robot, q, v, a, tau)
    compiled, missing = _try_compiled(robot, q, v, a, tau)
    solver_bound, rows = 8 * _EPS * float(np.linalg.cond(truth["M"]).max()), list[Row]()
    for quantity, scale in _scales(robot, truth, v, a).items():
        bound = solver_bound if quantity == "a" else _TOLERANCE
        for name, dynamics in (methods | compiled).items():
            error = max_ratio(dynamics[quantity] - truth[quantity], scale)
            rows.append((quantity, name, "closed form", error, bound))
    return rows, missing


def _scales(robot: MobileRobot, truth: Dynamics, v: Array, a: Array) -> Dynamics:
    M = truth["M"]
    diagonal = np.sqrt(np.einsum("...ii->...i", M))
    reach = max(1.0, float(np.linalg.norm(robot.com[:2])))  # factor of the speed of the centre of mass
    speed = robot.mass * np.square(v).sum(-1, keepdims=True) * reach
    return {
        "M": diagonal[..., :, None] * diagonal[..., None, :],
        "n": speed,
        "tau": np.einsum("...ij,...j->...i", np.abs(M), np.abs(a)) + speed,
        "a": np.linalg.norm(truth["a"], axis=-1, keepdims=True) + speed / robot.mass,
    }


def _closed_form(robot: MobileRobot, q: Array, v: Array, a: Array) -> Dynamics:
    mass = {"mass": robot.mass, "com": robot.com[:2]}
    body = mass | {"yaw_inertia": robot.yaw_inertia}
    tau = closed_form.inverse_dynamics(q, v, a, **body)
    return {
        "M": closed_form.mass_matrix(q, **body),
        "n": closed_form.nonlinear_effects(q, v, **mass),
        "tau": tau,
        "a": closed_form.forward_dynamics(q, v, tau, **body),
    }


@lru_cache(maxsize=8)
def _numeric(table: DHTable) -> tuple[Numeric, Numeric]:
    """Return the functions from the Newton-Euler recursion and from Lagrange's equations for a table."""
    derivation = lecture(table)
    return derivation.numeric(), lagrange(derivation).numeric()


def _symbolic(numeric: Numeric, robot: MobileRobot, q: Array, v: Array, a: Array, tau: Array) -> Dynamics:
    parameters = {"m": robot.mass, "Icz": robot.yaw_inertia, "xbc": robot.com[0], "ybc": robot.com[1]}
    M, n = numeric.mass_matrix(q, parameters), numeric.nonlinear_effects(q, v, parameters)
    return {"M": M, "n": n, "tau": numeric.inverse_dynamics(q, v, a, parameters), "a": _solve(M, tau - n)}


def _solve(M: Array, force: Array) -> Array:
    """Return M^-1 force; NaN for a singular M, which then agrees with nothing."""
    try:
        return np.asarray(np.linalg.solve(M, force[..., None])[..., 0], np.float64)
    except np.linalg.LinAlgError:
        return np.full(force.shape, np.nan)


_ROUNDING = 1e-14  # dozens of roundings, relative to the scale of the terms
_GRAVITY = 9.81  # [m/s^2]
_PARTS = "Newton-Euler of the parts"


def compare_mounted(robot: MobileRobot, states: int, rng: np.random.Generator) -> tuple[list[Row], str]:
    """Return the comparisons of all methods for a robot with arms, see `verify`, and a missing method."""
    q = robot.random_configuration(rng, (states,))
    q[:, 2] = rng.uniform(-4 * np.pi, 4 * np.pi, states)
    v, a = rng.normal(size=(2, states, robot.nv))
    units = [np.broadcast_to(unit, v.shape) for unit in np.eye(robot.nv)]
    tau, g = stack_values(robot.inverse_dynamics, q, v, a), stack_values(robot.gravity, q)
    results = pinocchio_dynamics(robot, q, v, a, tau)
    M, n = results["M"], results["n"]
    columns = np.stack([stack_values(robot.inverse_dynamics, q, 0 * v, unit) - g for unit in units], axis=-1)
    parts, resting = Parts(robot, q, v), Parts(robot, q, 0 * v)
    columns_M = resting.forces(np.stack(units), gravity=False)
    methods = {
        ("M", "CRBA", _PARTS): M - np.moveaxis(columns_M, 0, -1),
        ("n", "RNEA", _PARTS): n - parts.forces(0 * a),
        ("tau", "RNEA", _PARTS): tau - parts.forces(a),
        ("f", "RNEA", _PARTS): stack_values(robot.ground_wrench, q, v, a) - parts.ground_wrench(a),
        ("M", "CRBA", "RNEA's columns"): M - columns,
        ("M3", "CRBA", "closed form of the lump"): M[:, :3, :3]
        - closed_form.mass_matrix(q[:, :3], **composite_body(robot, q)),
        ("n", "RNEA", "C(q, v) v + g(q)"): n - apply(stack_values(robot.coriolis_matrix, q, v), v) - g,
        ("tau", "RNEA", "M a + n"): tau - apply(M, a) - n,
        ("a", "ABA", "M^-1 (tau - n)"): results["a"] - np.linalg.solve(M, (tau - n)[..., None])[..., 0],
    }
    compiled, missing = _try_compiled(robot, q, v, a, tau)
    for dynamics in compiled.values():
        references = {"M": "CRBA", "n": "RNEA", "tau": "RNEA", "a": "ABA"}
        methods |= {(x, COMPILED, references[x]): dynamics[x] - results[x] for x in references}
    scales = _mounted_scales(parts, v, a, M)
    return [(*names, max_ratio(gap, scales[names[0]]), _ROUNDING) for names, gap in methods.items()], missing


def _mounted_scales(parts: Parts, v: Array, a: Array, M: Array) -> dict[str, Array]:
    """Return the size of the terms in the sum for each quantity.

    A joint moves the material beyond it, of mass m and second moment J = int r^2 dm about its origin. By
    Cauchy and Schwarz, its force is at most sqrt(m K) times the acceleration of the material, with K = J for
    a revolute and K = m for a prismatic joint. The coupling of two joints is at most sqrt(K_i K_j).
    """
    masses, K, reach = parts.moved_masses()
    reach = np.maximum(1.0, reach)
    speed = parts.nv * np.square(v).sum(-1) * reach
    change = np.sqrt(parts.nv * np.square(a).sum(-1)) * reach
    inertia = np.sqrt(masses * K)
    pair = np.sqrt(K[..., :, None] * K[..., None, :])
    acceleration = (_GRAVITY + change + speed)[:, None]
    tau = inertia * acceleration
    return {
        "M": pair + _GRAVITY * inertia[..., None],
        "M3": pair[:, :3, :3],
        "n": inertia * (_GRAVITY + speed)[:, None],
        "tau": tau,
        "f": inertia[:, [0, 0, 0, 2, 2, 2]] * acceleration,  # mass for forces, inertia about psi for moments
        "a": apply(np.abs(np.linalg.inv(M)), tau),
    }
