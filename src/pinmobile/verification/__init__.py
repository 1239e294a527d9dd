"""Every route to M, n, tau and the acceleration side by side, with the largest difference."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import Any

import numpy as np

from pinmobile import closed_form
from pinmobile.arrays import Array, instance, seeded, whole
from pinmobile.compiled import vectorize
from pinmobile.derivation import Numeric, lagrange, lecture
from pinmobile.dh import DHTable
from pinmobile.errors import NotTraceable
from pinmobile.robot import MobileRobot
from pinmobile.verification._wheels import Row, compare_wheeled
from pinmobile.verification.bodies import Parts, lumped, off_by, times
from pinmobile.wheels import WheeledRobot

__all__ = ["Comparison", "Verification", "verify"]

_MOST = 1_000_000  # states


@dataclass(frozen=True)
class Comparison:
    """The largest difference of one quantity between two routes.

    Attributes
    ----------
    quantity : str
        ``"M"``, ``"n"``, ``"tau"`` or ``"a"``; of a robot with arms also ``"M3"``, its base's block, and
        ``"f"``, the ground's wrench; of a robot on wheels see `verify`.
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
    robot : MobileRobot or WheeledRobot
        What was verified.
    states : int
        Number of random states.
    rows : tuple of Comparison
        One per quantity and route.
    missing : str
        Which route there is none of, and why; empty where all are there.
    """

    robot: MobileRobot | WheeledRobot
    states: int
    rows: tuple[Comparison, ...]
    missing: str = ""

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
        against = {row.against for row in self.rows}
        names = [row.route if len(against) == 1 else f"{row.route} / {row.against}" for row in self.rows]
        width = max(32, *map(len, names))
        first = max(3, *(len(row.quantity) for row in self.rows))
        head = f"{'':{first}} {'route':{width}} {'largest difference':>18} {'bound':>9}"
        lines = [
            f"{row.quantity:{first}} {name:{width}} {row.difference:18.1e} {row.bound:9.1e}  "
            f"{'agrees' if row.agrees else 'DIFFERS'}"
            for name, row in zip(names, self.rows, strict=True)
        ]
        what = f"the {against.pop()}" if len(against) == 1 else "another"
        left_out = [f"left out, {self.missing}"] if self.missing else []
        return "\n".join([f"{self.states} random states, each route against {what}", head, *lines, *left_out])


def verify(
    robot: MobileRobot | WheeledRobot, *, states: int = 200, seed: int | np.random.Generator = 0
) -> Verification:
    """Compare every route to the robot's dynamics on random states.

    Of a bare base the routes are the closed form (hand-derived), Pinocchio (CRBA, RNEA, ABA), the symbolic
    Newton-Euler recursion and Lagrange's equations, these two for the robot's own DH table, and the machine
    code that ensembles of it run. Differences are relative to the scale of the terms: sqrt(M_ii M_jj) for M,
    m |v|^2 for n, |M| |a| + m |v|^2 for tau and |a| + |v|^2 for the acceleration; |v|^2 times the distance
    of the centre of mass where that is above 1 m. M, n and tau must be within 1e-12, the last within 8 eps
    cond(M).

    Of a base with arms or loads M by CRBA, n, tau and the ground's wrench f by RNEA are compared with
    Newton's and Euler's laws, written out for what the parts themselves say: the body, each arm as it was
    read, each load. Nothing of the model that they are assembled into is taken for that. Then Pinocchio's
    algorithms against each other: M against RNEA's columns; n against C(q, v) v + g(q); tau against M a + n;
    the acceleration by ABA against M^-1 (tau - n); and M[:3, :3] against the closed form of the body that all
    of it is with its arms locked. Last the machine code that ensembles of it run, against CRBA, RNEA and ABA;
    where there is none, `missing` says why. With m the mass beyond a joint, K its second moment about the
    joint (m where it slides) and r the reach of the whole [m], at least 1, the scales are sqrt(K_i K_j) for
    M, sqrt(m K) (9.81 + nv r |v|^2) for n, sqrt(m K) (9.81 + sqrt(nv) r |a| + nv r |v|^2) for tau, those of
    x and psi also for the forces and the moments of f, and |M^-1| times that for the acceleration; gravity
    in RNEA's columns adds 9.81 sqrt(m K) to that of M. Each must be within 1e-14.

    Of a robot on wheels that roll, at random states that do: M by CRBA and n by RNEA of the tree in which
    wheels are joints, and the torques that its accelerations and constraint forces by KKT say, against
    Newton's and Euler's laws of the body, arms and each wheel, one by one; the acceleration and the ground's
    forces against the terms that wheels are to the energy in the plane, by numbers and as machine code; M, n
    and B of the independent velocities against the tree, and against the closed form where there is one: two
    fixed wheels on an axle, fixed wheels with rollers, a car (with arms M alone, its arms locked);
    nu' against the rate of nu as KKT moves it; the power of inputs, forces and gravity against the rate of
    kinetic energy. Where wheels slip, a step of 1 ms, in as many passes as change it: what it says of forces,
    of loads and of power at mid-step against the same laws, and forces against mu times the load. Scales are
    as above, those of a wheel with K its inertia about the axle and m its mass and K / r^2, and with the
    forces that act. Each must be within 1e-13; within 1e-12 where equations were solved, whose rounding grows
    with their condition; within 1e-9 where a rate is a difference of fourth order.

    Parameters
    ----------
    robot : MobileRobot or WheeledRobot
        Any mass, inertia, centre of mass and table, any arms and loads, any wheels.
    states : int
        Number of states: psi over two turns to either side, arms within their limits, v and a normal with
        unit deviation.
    seed : int or Generator
        Of the states.

    Returns
    -------
    verification : Verification
        Print it; ask `passed` and `largest`.

    Raises
    ------
    InvalidArgument
        If `states` is not a whole number from 1 to 1,000,000, or another argument not what is expected.
    """
    instance("robot", robot, MobileRobot | WheeledRobot, "a MobileRobot or a WheeledRobot")
    rng, count = seeded("seed", seed), whole("states", states, most=_MOST)
    compare: Any = compare_wheeled
    if isinstance(robot, MobileRobot):
        compare = compare_mounted if robot.mounts or robot.loads else compare_planar
    rows, missing = compare(robot, count, rng)
    return Verification(robot, count, tuple(Comparison(*row) for row in rows), missing)


Dynamics = dict[str, Array]
"""M, n, tau for an acceleration, and a for a force, by their letters, of n states."""

COMPILED = "compiled for ensembles"


def each(function: Callable[..., Array], *states: Array) -> Array:
    """Return what a function gives for one state after the other; many at once may be machine code."""
    return np.stack([function(*state) for state in zip(*states, strict=True)])


def by_pinocchio(robot: MobileRobot, q: Array, v: Array, a: Array, tau: Array) -> Dynamics:
    """Return the dynamics by CRBA, RNEA and ABA."""
    return {
        "M": each(robot.mass_matrix, q),
        "n": each(robot.nonlinear_effects, q, v),
        "tau": each(robot.inverse_dynamics, q, v, a),
        "a": each(robot.forward_dynamics, q, v, tau),
    }


def by_machine_code(robot: MobileRobot, q: Array, v: Array, a: Array, tau: Array) -> Dynamics:
    """Return the dynamics by the laws that ensembles compile.

    Raises
    ------
    NotTraceable
        If they do not: a joint has several coordinates, or the joints are too many.
    """
    found = vectorize(partial(_dynamics, robot.array_dynamics), keep=False)(q, v, a, tau)
    return dict(zip(("M", "n", "tau", "a"), found, strict=True))


def _compiled(robot: MobileRobot, *states: Array) -> tuple[dict[str, Dynamics], str]:
    """Return the dynamics by machine code, by the name of the route, and why there are none."""
    try:
        return {COMPILED: by_machine_code(robot, *states)}, ""
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
_TOLERANCE = 1e-12  # some thousand roundings, relative to the scale of the terms


def compare_planar(robot: MobileRobot, states: int, rng: np.random.Generator) -> tuple[list[Row], str]:
    """Return every route of a bare body against the closed form, see `verify`, and why one is missing."""
    shape = (states, 3)
    q = rng.uniform(-4 * np.pi, 4 * np.pi, shape)
    v, a = rng.normal(size=shape), rng.normal(size=shape)
    truth = _closed_form(robot, q, v, a)
    tau = truth["tau"]
    found = {"Pinocchio (CRBA, RNEA, ABA)": by_pinocchio(robot, q, v, a, tau)}
    for name, numeric in zip(("Newton-Euler", "Lagrange"), _numeric(robot.dh), strict=True):
        found[f"symbolic {name}"] = _symbolic(numeric, robot, q, v, a, tau)
    compiled, missing = _compiled(robot, q, v, a, tau)
    solved, rows = 8 * _EPS * float(np.linalg.cond(truth["M"]).max()), list[Row]()
    for quantity, scale in _scales(robot, truth, v, a).items():
        bound = solved if quantity == "a" else _TOLERANCE
        for name, dynamics in (found | compiled).items():
            off = off_by(dynamics[quantity] - truth[quantity], scale)
            rows.append((quantity, name, "closed form", off, bound))
    return rows, missing


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
    moved = {"mass": robot.mass, "com": robot.com[:2]}
    body = moved | {"yaw_inertia": robot.yaw_inertia}
    tau = closed_form.inverse_dynamics(q, v, a, **body)
    return {
        "M": closed_form.mass_matrix(q, **body),
        "n": closed_form.nonlinear_effects(q, v, **moved),
        "tau": tau,
        "a": closed_form.forward_dynamics(q, v, tau, **body),
    }


@lru_cache(maxsize=8)
def _numeric(table: DHTable) -> tuple[Numeric, Numeric]:
    """Return the functions that Newton-Euler and Lagrange lead to for a table."""
    derivation = lecture(table)
    return derivation.numeric(), lagrange(derivation).numeric()


def _symbolic(numeric: Numeric, robot: MobileRobot, q: Array, v: Array, a: Array, tau: Array) -> Dynamics:
    parameters = {"m": robot.mass, "Icz": robot.yaw_inertia, "xbc": robot.com[0], "ybc": robot.com[1]}
    M, n = numeric.mass_matrix(q, parameters), numeric.nonlinear_effects(q, v, parameters)
    return {"M": M, "n": n, "tau": numeric.inverse_dynamics(q, v, a, parameters), "a": _solved(M, tau - n)}


def _solved(M: Array, force: Array) -> Array:
    """Return M^-1 force; not a number where M is singular to rounding, which then agrees with nothing."""
    try:
        return np.asarray(np.linalg.solve(M, force[..., None])[..., 0], np.float64)
    except np.linalg.LinAlgError:
        return np.full(force.shape, np.nan)


_ROUNDING = 1e-14  # some dozen roundings, relative to the scale of the terms
_GRAVITY = 9.81  # [m/s^2]
_PARTS = "Newton-Euler of the parts"


def compare_mounted(robot: MobileRobot, states: int, rng: np.random.Generator) -> tuple[list[Row], str]:
    """Return the routes of a robot with arms against each other, see `verify`, and which is missing."""
    q = robot.random_configuration(rng, (states,))
    q[:, 2] = rng.uniform(-4 * np.pi, 4 * np.pi, states)
    v, a = rng.normal(size=(2, states, robot.nv))
    units = [np.broadcast_to(unit, v.shape) for unit in np.eye(robot.nv)]
    tau, g = each(robot.inverse_dynamics, q, v, a), each(robot.gravity, q)
    own = by_pinocchio(robot, q, v, a, tau)
    M, n = own["M"], own["n"]
    columns = np.stack([each(robot.inverse_dynamics, q, 0 * v, unit) - g for unit in units], axis=-1)
    parts, still = Parts(robot, q, v), Parts(robot, q, 0 * v)
    by_parts = still.forces(np.stack(units), gravity=False)
    routes = {
        ("M", "CRBA", _PARTS): M - np.moveaxis(by_parts, 0, -1),
        ("n", "RNEA", _PARTS): n - parts.forces(0 * a),
        ("tau", "RNEA", _PARTS): tau - parts.forces(a),
        ("f", "RNEA", _PARTS): each(robot.ground_wrench, q, v, a) - parts.ground_wrench(a),
        ("M", "CRBA", "RNEA's columns"): M - columns,
        ("M3", "CRBA", "closed form of the lump"): M[:, :3, :3]
        - closed_form.mass_matrix(q[:, :3], **lumped(robot, q)),
        ("n", "RNEA", "C(q, v) v + g(q)"): n - times(each(robot.coriolis_matrix, q, v), v) - g,
        ("tau", "RNEA", "M a + n"): tau - times(M, a) - n,
        ("a", "ABA", "M^-1 (tau - n)"): own["a"] - np.linalg.solve(M, (tau - n)[..., None])[..., 0],
    }
    compiled, missing = _compiled(robot, q, v, a, tau)
    for dynamics in compiled.values():
        against = {"M": "CRBA", "n": "RNEA", "tau": "RNEA", "a": "ABA"}
        routes |= {(x, COMPILED, against[x]): dynamics[x] - own[x] for x in against}
    scales = _mounted_scales(parts, v, a, M)
    return [(*names, off_by(off, scales[names[0]]), _ROUNDING) for names, off in routes.items()], missing


def _mounted_scales(parts: Parts, v: Array, a: Array, M: Array) -> dict[str, Array]:
    """Return the size of the terms that each quantity is the sum of.

    A joint feels the material beyond it, of mass m and second moment J = int |r|^2 dm about its origin: by
    Cauchy and Schwarz at most sqrt(m K) times the acceleration of the material, with K = J where it turns and
    m where it slides, and what two joints exchange is at most sqrt(K_i K_j).
    """
    masses, K, reach = parts.beyond()
    reach = np.maximum(1.0, reach)
    speed = parts.nv * np.square(v).sum(-1) * reach
    push = np.sqrt(parts.nv * np.square(a).sum(-1)) * reach
    felt = np.sqrt(masses * K)
    pair = np.sqrt(K[..., :, None] * K[..., None, :])
    accelerated = (_GRAVITY + push + speed)[:, None]
    tau = felt * accelerated
    return {
        "M": pair + _GRAVITY * felt[..., None],
        "M3": pair[:, :3, :3],
        "n": felt * (_GRAVITY + speed)[:, None],
        "tau": tau,
        "f": felt[:, [0, 0, 0, 2, 2, 2]] * accelerated,  # the mass for forces, that about psi for moments
        "a": times(np.abs(np.linalg.inv(M)), tau),
    }
