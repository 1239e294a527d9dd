"""`Bearing`: what a `WheeledRobot` tells of the ground under it, and what is judged."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from pinmobile.arrays import Array, ArrayLike, broadcast, finite, finite_answer, in_numbers, vector
from pinmobile.errors import InvalidArgument, shown
from pinmobile.measures import Measure
from pinmobile.parts import also_symbols, evolved
from pinmobile.plant import ContactLoads, Contacts, SlipMargins
from pinmobile.wheels.following import Following, carried, told
from pinmobile.wheels.ground import Ramp
from pinmobile.wheels.touching import contacts_of


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
        return type(self)(self.robot, self.table, evolved(self.ground, {"ramp": Ramp(angle, direction)}))

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
        if not hasattr(reference, "q"):
            raise InvalidArgument(f"reference is {shown(reference)}, expected a Reference: q, v and a")
        desired = finite("reference.q", reference.q)
        if desired.shape[-1:] not in [(n,) for n in self.leading]:
            listed = ", ".join(map(str, self.leading))
            raise InvalidArgument(f"reference.q has shape {desired.shape}, expected (..., k), k of {listed}")
        state = {"q": self._q(q), "v": self._v("v", v), "a": self._v("a", a), "u": vector("u", u, self.nu)}
        lead = broadcast(**state, **{"reference.q": desired})
        q, v, a, u, desired = (np.broadcast_to(x, (*lead, x.shape[-1])) for x in (*state.values(), desired))
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            found = np.asarray(self.array_dynamics.measured(t, q, v, a, u, reference._replace(q=desired)))
        finite_answer(np.where(found == -np.inf, 0.0, found), **state)  # a margin may be minus infinity
        return np.array(np.broadcast_to(found, (*lead, len(self.measures))))
