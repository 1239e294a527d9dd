"""`Following`: what the ground has to bear where a robot on wheels follows a reference, however fast."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, final

import numpy as np

from pinmobile.arrays import Array
from pinmobile.errors import InvalidArgument
from pinmobile.plant import ContactLoads, SlipMargins, TorqueMargins
from pinmobile.robot import number
from pinmobile.wheels.loads import wheel_loads
from pinmobile.wheels.standing import Group, margin

_BASE = 3
_OFF = 1e-6  # of the largest rate, beyond which wheels would slide sideways; of the largest torque
_HALF_TURN = np.pi


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
