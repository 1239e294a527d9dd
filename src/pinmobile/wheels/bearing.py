"""`Bearing`: what a `WheeledRobot` tells of the ground under it: loads, margins, contacts; `Following`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from pinmobile.arrays import Array, ArrayLike, broadcast, finite, finite_answer, in_numbers, shaped, vector
from pinmobile.errors import InvalidArgument, shown
from pinmobile.measures import Measure
from pinmobile.parts import Desired, also_symbols, evolved, required
from pinmobile.plant import ContactLoads, Contacts, SlipMargins, TorqueMargins
from pinmobile.robot import number
from pinmobile.wheels.ground import Ramp
from pinmobile.wheels.kinematics import Kinematics
from pinmobile.wheels.loads import wheel_loads
from pinmobile.wheels.standing import Group, margin

_BASE = 3
_OFF = 1e-6  # of the largest rate, beyond which wheels would slide sideways; of the largest torque
_HALF_TURN = np.pi
_STILL = 1e-9  # [rad/s], below which a body does not turn
_TOLD = ("along", "across", "slip_along", "slip_across", "loads", "slides")
_ACROSS = {"rolling": 0, "roller": 0, "lateral": 1, "across": 1}


class Bearing:
    """Methods of a `WheeledRobot`; all broadcast over leading axes."""

    @in_numbers
    def ground_wrench(self: Any, q: ArrayLike, v: ArrayLike, a: ArrayLike) -> Array:
        """Return what the ground exerts on the robot that moves so, shape (..., 6), wheels spinning.

        Of Pinocchio's tree: along the axes of the body's frame, with the moment about its origin, which lies
        on the ground. Whatever else acts from outside is in it.
        """
        at, rate, faster = self._moving(q, v, a)
        whole, rates, G, bent = self._tree.state_of(at, rate)
        within = np.einsum("...ij,...j->...i", G, faster) + bent
        return np.asarray(
            self._tree.ground_wrench(whole, rates, finite_answer(within, q=at, v=rate, a=faster))
        )

    @in_numbers
    def mount_wrench(self: Any, q: ArrayLike, v: ArrayLike, a: ArrayLike, mount: str | None = None) -> Array:
        """Return the wrench of an arm on the body at its mount, (..., 6): see `MobileRobot.mount_wrench`."""
        at, rate, faster = self._moving(q, v, a)
        n, slack = self.robot.nv, self.array_dynamics._slack
        at, rate, faster = at[..., :n], rate[..., :n], faster[..., :n].copy()
        faster[..., :2] -= self._fall[:2]  # gravity in the plane is as if the plane accelerated against it
        found = np.asarray(self.robot.mount_wrench(at, rate, faster, mount))
        still = np.zeros_like(rate)
        return found - slack * self.robot.mount_wrench(at, still, still, mount) if slack else found

    def _moving(self: Any, q: ArrayLike, v: ArrayLike, a: ArrayLike) -> tuple[Array, Array, Array]:
        """Return a state and its acceleration, checked, with the same leading axes."""
        given: dict[str, Array] = {"q": self._q(q), "v": self._v("v", v), "a": self._v("a", a)}
        lead = broadcast(**given)
        at, rate, faster = (np.broadcast_to(x, (*lead, x.shape[-1])) for x in given.values())
        return at, rate, faster

    def _felt(self: Any, q: Array, v: Array, a: Array) -> tuple[Any, list[Any]]:
        """Return the state, and accelerations along the body's axes less gravity in the plane."""
        body = self.array_dynamics
        state, c, s = body.state(q, v), np.cos(q[..., 2]), np.sin(q[..., 2])
        along = [c * a[..., 0] + s * a[..., 1], c * a[..., 1] - s * a[..., 0]]
        return state, body.felt(state, [*along, *np.moveaxis(a[..., 2:], -1, 0)])

    def _check_stands(self: Any) -> None:
        if not self.grounded:
            raise InvalidArgument(
                "robot does not tell how high it is above the ground, on which the loads of its wheels "
                "depend; expected one read with ground="
            )
        self.check_area()

    @in_numbers
    def contact_loads(self: Any, q: ArrayLike, v: ArrayLike, a: ArrayLike) -> ContactLoads:
        """Return what each wheel and support carries, those of the supports behind.

        With more than three, as equal springs share it; what would pull has lifted off, and the others carry.

        Parameters
        ----------
        q, v, a : array_like, shape (..., nq), (..., nv), (..., nv)
            State and acceleration.
        """
        self._check_stands()
        at, rate, faster = self._moving(q, v, a)
        state, felt = self._felt(at, rate, faster)
        return carried(self.array_dynamics, state, felt, at, at.shape[:-1])

    def slip_margins(self: Any, motion: Any) -> SlipMargins:
        """Return the friction that each wheel, or axle, has left before it slips.

        Of wheels that roll it is ``mu N`` less the size of the ground's force, which follows from v, a and u;
        forces that push the body count as if the ground exerted them. Where rolling does not determine how
        wheels of an axle share the force across them, it is the axle's margin:
        ``sum sqrt((mu N)^2 - along^2) - |across|``, and no more than ``mu N - |along|`` of each. Wheels that
        may slip have margins in runs, whose signals tell the forces.

        Parameters
        ----------
        motion : Rollout or Motion
            With q, v, a and u.
        """
        self._check_stands()
        if not self._rolls_ideally:
            return self._recorded_margins(motion)  # type: ignore[no-any-return]
        body = self.array_dynamics
        if not body.groups:
            raise InvalidArgument(
                "robot has wheels on a gear train, which share what it transmits, so rolling does not tell "
                "the force of each; expected ground=Coulomb()"
            )
        if getattr(motion, "u", None) is None:
            raise InvalidArgument(
                "motion.u is None, expected the input, on which the forces of wheels depend: Motion(..., u=u)"
            )
        q, v, a = self._q(motion.q), self._v("v", motion.v), self._v("a", motion.a)
        u = vector("u", motion.u, self.nu)
        lead = broadcast(q=q, v=v, a=a, u=u)
        q, v, a, u = (np.broadcast_to(x, (*lead, x.shape[-1])) for x in (q, v, a, u))
        state, felt = self._felt(q, v, a)
        return told(body, state, felt, u, q, lead)[1]

    def contacts(
        self: Any, q: ArrayLike, v: ArrayLike, a: ArrayLike, u: ArrayLike, signals: Mapping[str, Any]
    ) -> Contacts:
        """Return what the ground does at the wheels at the samples of a run, see `Contacts`.

        Parameters
        ----------
        q, v, a, u : array_like, shape (n, ...)
            Of the samples.
        signals : mapping of str to Signal
            Of the run.
        """
        return contacts_of(
            self, self._q(q), self._v("v", v), self._v("a", a), vector("u", u, self.nu), signals
        )

    def follows(self: Any, t: ArrayLike, reference: Any) -> Following:
        """Return what rolls along a reference: its ``at(factor)`` tells what the ground bears.

        Parameters
        ----------
        t : array_like, shape (N,)
            Times, ascending [s].
        reference : Reference
            At these times.
        """
        return Following.of(self, finite("t", t), reference)

    def _recorded_margins(self: Any, motion: Any) -> SlipMargins:
        signals = getattr(motion, "signals", None) or {}
        if not {"along", "across", "loads"} <= set(signals):
            raise InvalidArgument(
                "motion has no signals of the wheels' forces, without which those on Coulomb ground are not "
                "known; expected the Rollout of a simulation"
            )
        along, across, borne = (np.asarray(signals[name][1]) for name in ("along", "across", "loads"))
        rollers = np.array([wheel.roller is not None for wheel in self.table.wheels])
        size = np.where(rollers, np.abs(along), np.hypot(along, across))
        return SlipMargins(self.table.names, self.mu * borne[..., : len(self.table)] - size, along, across)

    def on_ramp(self: Any, angle: float, direction: float = 0.0) -> Any:
        """Return the robot on ground that rises.

        Parameters
        ----------
        angle, direction : float
            As of `Ramp` [rad].
        """
        if not hasattr(self.ground, "ramp"):
            raise InvalidArgument(
                f"ground is {shown(self.ground)}, which has no ramp, expected Rolling() or Coulomb()"
            )
        return type(self)(self.robot, self.table, evolved(self.ground, ramp=Ramp(angle, direction)))

    @property
    def measures(self: Any) -> tuple[Measure, ...]:
        """What is worth judging about it beside errors: what `measured` returns.

        The smallest load of wheels and supports; of wheels that roll the smallest slip margin, see
        `slip_margins`, and of those that may slip the largest velocity at which one slides; where there are
        limits, the largest torque of what motors allow; with arms, what is judged of these, see
        `MobileRobot.measures`.
        """
        return self.array_dynamics.measures  # type: ignore[no-any-return]

    @also_symbols
    def measured(
        self: Any, t: ArrayLike, q: ArrayLike, v: ArrayLike, a: ArrayLike, u: ArrayLike, reference: Any
    ) -> Array:
        """Return its `measures`, shape (..., m).

        Parameters
        ----------
        t : array_like, shape (...)
            Time [s], on which nothing depends.
        q, v, a, u : array_like, shape (..., nq), (..., nv), (..., nv), (..., nu)
            State, acceleration and input.
        reference : Reference
            Where the first coordinates should be.
        """
        required("reference", reference, Desired)
        wanted = [("...", n) for n in self.leading]
        desired = shaped("reference.q", finite("reference.q", reference.q), *wanted)
        state = {"q": self._q(q), "v": self._v("v", v), "a": self._v("a", a), "u": vector("u", u, self.nu)}
        lead = broadcast(**state, **{"reference.q": desired})
        q, v, a, u, desired = (np.broadcast_to(x, (*lead, x.shape[-1])) for x in (*state.values(), desired))
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            found = np.asarray(self.array_dynamics.measured(t, q, v, a, u, reference._replace(q=desired)))
        finite_answer(np.where(found == -np.inf, 0.0, found), **state)  # a margin may be minus infinity
        return np.array(np.broadcast_to(found, (*lead, len(self.measures))))


@final
@dataclass(frozen=True, eq=False)
class Following:
    """A robot whose wheels roll along a reference: its states, and the torques of least norm for them.

    Parameters
    ----------
    body : RollingDynamics
        What rolls.
    q, v : ndarray, shape (N, nq), (N, nv)
        States.
    rates : ndarray, shape (N, m)
        Rates of the independent velocities.
    efforts : ndarray, shape (arms,)
        Largest torques of the arms' joints [N m].
    """

    body: Any
    q: Array
    v: Array
    rates: Array
    efforts: Array

    @classmethod
    def of(cls, robot: Any, t: Array, reference: Any) -> Following:
        """Return that of a `WheeledRobot`.

        Parameters
        ----------
        robot : WheeledRobot
            Whose it is.
        t : ndarray, shape (N,)
            Times [s].
        reference : Reference
            At these times.

        Raises
        ------
        InvalidArgument
            If the robot does not roll, its wheels cannot follow or its motors cannot drive it there, or it
            is not known where it stands.
        """
        robot._check_stands()
        body = robot._rolling
        if not body.groups:
            raise InvalidArgument(
                "robot has wheels on a gear train, of which rolling does not tell the forces"
            )
        whole = [robot.robot.start(type(reference)(*(x[k] for x in reference))) for k in range(len(t))]
        began = [body.begun(q, v) for q, v in whole]
        q, v = np.array([q for q, _ in began]), np.array([v for _, v in began])
        n, ns = _BASE + body.na, len(body.table.axes)
        turning, faster = np.zeros((2, len(t), ns))
        if ns and len(t) > 3:
            from scipy.interpolate import CubicSpline

            angles = np.unwrap(q[:, n : n + ns], axis=0, period=_HALF_TURN)
            q[:, n : n + ns] = angles
            spline = CubicSpline(t, angles)
            turning, faster = spline(t, 1), spline(t, 2)
        v[:, n : n + ns] = turning
        state = body.state(q, v)
        S, _ = body.freedom.solution(state)
        nu = body.freedom.velocities(state)
        rolls = np.asarray(
            body.in_plane(state, [sum(x * y for x, y in zip(r, nu, strict=True)) for r in S], q)
        )
        off = np.abs(rolls[:, :_BASE] - v[:, :_BASE]).max(axis=1)
        if (off > _OFF * (1 + np.abs(v).max())).any():
            k = int(np.argmax(off))
            raise InvalidArgument(
                f"reference moves the body by {off[k]:.3g} m/s, or rad/s, at {t[k]:.6g} s as its wheels "
                "cannot roll, expected one that they can follow, such as Tangent(path)"
            )
        state = body.state(q, rolls)
        a = np.zeros((len(t), body.nv))
        a[:, : reference.a.shape[-1]] = reference.a
        along = [state.c * a[:, 0] + state.s * a[:, 1], state.c * a[:, 1] - state.s * a[:, 0]]
        offset = body.freedom.offset(state, [*along, *np.moveaxis(a[:, 2:], -1, 0)])
        own = len(offset) - body.na - len(body.choice.free)
        rates = [
            *offset[:own],
            *np.moveaxis(a[:, _BASE:n], -1, 0),
            *(faster[:, k] for k in body.choice.free),
        ]
        found = cls(body, q, rolls, _stacked(rates, (len(t),)), robot.robot.effort_limit[_BASE:])
        found._driven(q, rolls, found.rates)
        return found

    def _driven(self, q: Array, v: Array, rates: Array) -> Array:
        """Return the torques of least norm, and refuse what no torques do."""
        if not self.body.nu:
            raise InvalidArgument("robot has no motor, expected one that can be driven along a reference")
        own = self.body.reduced(q, v)
        force = np.einsum("...ij,...j->...i", own.M, rates) + own.n
        B = np.broadcast_to(own.B, (*force.shape, own.B.shape[-1]))
        u = np.einsum("...ij,...j->...i", np.linalg.pinv(B), force)
        rest = np.abs(np.einsum("...ij,...j->...i", B, u) - force).max()
        if rest > _OFF * (1 + np.abs(force).max()):
            raise InvalidArgument(
                f"reference needs a force of {rest:.3g} N, or N m, that no motor of the robot exerts, "
                "expected a drive with a motor for each degree of freedom, or a reference that needs none"
            )
        return np.asarray(u)

    def at(self, factor: float) -> tuple[ContactLoads, SlipMargins, TorqueMargins]:
        """Return loads, slip and torque margins where it goes along `factor` times as fast, (N, k) each."""
        body, q, v = self.body, self.q, factor * self.v
        state = body.state(q, v)
        S, gamma = body.freedom.solution(state)
        rest = body.freedom.unmoved(state, S, gamma)
        rates = np.moveaxis(factor**2 * self.rates, -1, 0)
        a = [sum(x * y for x, y in zip(row, rates, strict=True)) + g for row, g in zip(S, rest, strict=True)]
        felt = body.felt(state, [number(x) for x in a])
        u = self._driven(q, v, np.moveaxis(rates, 0, -1))
        return *told(body, state, felt, u, q, (len(q),)), self._margins(v, u)

    def _margins(self, v: Array, u: Array) -> TorqueMargins:
        """Return what motors have left of their torques, those of arms and wheels."""
        body, na = self.body, self.body.na
        rates = v[:, _BASE + na :] @ np.array([each.column for each in body.table.actuators], float).T
        found = list((self.efforts - np.abs(u[:, :na])).T)
        for actuator, torque, rate in zip(body.table.actuators, u[:, na:].T, rates.T, strict=True):
            found.append(actuator.motor._margin(torque, rate))
        return TorqueMargins(tuple(one.name for one in body.inputs), np.stack(found, axis=-1))


def carried(body: Any, state: Any, felt: Any, q: Array, lead: tuple[int, ...]) -> ContactLoads:
    """Return what each contact carries, of arrays."""
    found = wheel_loads(body, state, felt, q)
    names = (*body.table.names, *(f"support {k + 1}" for k in range(len(body.table.supports))))
    values, springs = (_stacked(x, lead) for x in (found.values, found.springs))
    return ContactLoads(names, values, springs, np.broadcast_to(number(found.tips), lead) > 0)


def told(
    body: Any, state: Any, felt: Any, u: Array, q: Array, lead: tuple[int, ...]
) -> tuple[ContactLoads, SlipMargins]:
    """Return loads and slip margins of what rolls, of arrays."""
    borne = carried(body, state, felt, q, lead)
    found = margin(body, state, felt, u, list(np.moveaxis(borne.values, -1, 0)), q)
    names = tuple(name_of(body, group) for group in body.groups)
    return borne, SlipMargins(
        names, *(_stacked(x, lead) for x in (found.margins, found.along, found.lateral))
    )


def name_of(body: Any, group: Group) -> str:
    """Return what a group of wheels is called."""
    return " + ".join(body.table.names[k] for k in group.wheels)


def _stacked(values: Any, lead: tuple[int, ...]) -> Array:
    return np.stack([np.broadcast_to(number(x), lead) for x in values], axis=-1)


def contacts_of(wheeled: Any, q: Array, v: Array, a: Array, u: Array, signals: Mapping[str, Any]) -> Contacts:
    """Return the contacts of a robot on wheels at the samples of a run.

    On `Coulomb` ground they are the signals of the run, means over the step before. On `Rolling` ground they
    are the constraint forces of state and input, forces on the body beside it left out; their limits are what
    the wheels' own friction would give at the loads of the recorded acceleration.

    Parameters
    ----------
    wheeled : WheeledRobot
        The robot.
    q, v, a, u : ndarray, shape (n, ...)
        Of the samples.
    signals : mapping of str to Signal
        Of the run.
    """
    table, n = wheeled.table, len(q)
    k = len(table)
    steering = list(np.moveaxis(q[:, wheeled.robot.nq : wheeled.robot.nq + len(table.axes)], -1, 0))
    places, directions = _placed(Kinematics.of(table), q, steering)
    mu = wheeled.mu
    if not wheeled._rolls_ideally:
        _check_signals(signals, n)
        forces = np.stack([signals["along"].values, signals["across"].values], axis=-1)
        slips = np.stack([signals["slip_along"].values, signals["slip_across"].values], axis=-1)
        loads, slides = signals["loads"].values[:, :k], signals["slides"].values > 0.5
        regular = wheeled.mobility.is_regular
        determined = _known(wheeled) if regular else np.ones((k, 2), bool)
    else:
        forces, determined = _constrained(wheeled, q, v, u), _known(wheeled)
        loads, slips, slides = _carried(wheeled, q, v, a), np.zeros((n, k, 2)), np.zeros((n, k), bool)
        slips[..., 1] = _rolls_over(wheeled, q, v)
    across = [mu[i] if w.roller is None else w.friction.across for i, w in enumerate(table.wheels)]
    limits = loads[..., None] * np.stack([mu, across], axis=-1)
    return Contacts(
        table.names,
        places,
        directions,
        forces,
        determined,
        loads,
        limits,
        slips,
        np.asarray(slides, bool),
        _centre(wheeled.pose(q), wheeled.rate(q, v)),
    )


def _check_signals(signals: object, n: int) -> None:
    """Refuse signals that are not those of a run on ground where wheels slip."""
    for name in _TOLD:
        values = getattr(signals.get(name), "values", None) if isinstance(signals, Mapping) else None
        if not isinstance(values, np.ndarray) or values.ndim != 2 or len(values) != n:
            raise InvalidArgument(
                f"signals has no {name!r} of {n} samples, expected the signals of a run of this robot"
            )


def _placed(kinematics: Kinematics, q: Array, steering: list[Array]) -> tuple[Array, Array]:
    """Return where wheels touch the ground, shape (n, k, 2), and angles of their first direction, (n, k)."""
    c, s, n = np.cos(q[:, 2]), np.sin(q[:, 2]), len(q)
    places, directions = np.empty((n, len(kinematics.table), 2)), np.empty((n, len(kinematics.table)))
    for row, wheel in enumerate(kinematics.table.wheels):
        _, centre = kinematics.centre(row, steering)
        x, y = (number(p) for p in centre)
        places[:, row, 0], places[:, row, 1] = q[:, 0] + c * x - s * y, q[:, 1] + s * x + c * y
        head = kinematics.heading(row, steering)
        angle = np.arctan2(number(head.s), number(head.c)) + (wheel.roller or 0.0)
        directions[:, row] = q[:, 2] + angle
    return places, directions


def _rows_of(wheeled: Any) -> dict[int, tuple[int, int]]:
    """Return wheel and direction of each row of the constraints that is a wheel's."""
    own, found = wheeled.table.names, {}
    for j, name in enumerate(wheeled.constraint_names):
        wheel, _, kind = name.rpartition(" ")
        if wheel in own:
            found[j] = own.index(wheel), _ACROSS[kind]
    return found


def _known(wheeled: Any) -> NDArray[np.bool_]:
    """Return whether the force in each direction is determined where no wheel slides, shape (k, 2)."""
    found = np.ones((len(wheeled.table), 2), bool)
    for j, at in _rows_of(wheeled).items():
        found[at] = wheeled.mobility.determined[j]
    return found


def _constrained(wheeled: Any, q: Array, v: Array, u: Array) -> Array:
    """Return what holds the wheels where they roll, shape (n, k, 2)."""
    values = wheeled.constraint_forces(q, v, u).values
    forces = np.zeros((len(q), len(wheeled.table), 2))
    for j, (row, side) in _rows_of(wheeled).items():
        forces[:, row, side] = values[:, j]
    return forces


def _rolls_over(wheeled: Any, q: Array, v: Array) -> Array:
    """Return how fast the ground passes across rollers, shape (n, k) [m/s]; 0 of tyres."""
    found, rolling = np.zeros((len(q), len(wheeled.table))), wheeled.array_dynamics
    state = rolling.state(q, v)
    for row in rolling.kinematics.rows(state.steering, state.twist, state.rates, across=True):
        if row.kind == "across":
            entries = [*state.twist, *state.rates]
            terms = [number(x) * number(y) for x, y in zip(row.entries, entries, strict=True)]
            found[:, row.wheel] = sum(terms)
    return found


def _carried(wheeled: Any, q: Array, v: Array, a: Array) -> Array:
    """Return the loads of the wheels, shape (n, k) [N]; not a number where they cannot be told."""
    k = len(wheeled.table)
    if not wheeled.array_dynamics.stands:
        return np.full((len(q), k), np.nan)
    return np.asarray(wheeled.contact_loads(q, v, a).values[:, :k])


def _centre(pose: Array, rate: Array) -> Array:
    """Return the instantaneous centre of rotation, shape (n, 2)."""
    w = rate[:, 2]
    turns = np.abs(w) > _STILL
    safe = np.where(turns, w, 1.0)
    found = pose[:, :2] + np.stack([-rate[:, 1], rate[:, 0]], axis=-1) / safe[:, None]
    return np.where(turns[:, None], found, np.inf)
