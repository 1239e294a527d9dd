"""`WheeledRobot`: a robot on driven wheels, as a plant."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cached_property
from os import PathLike
from typing import Any, ClassVar, Self, final

import numpy as np

from pinmobile.arrays import Array, ArrayLike, broadcast, finite_answer, frozen, in_numbers, positive, vector
from pinmobile.errors import InvalidArgument, shown
from pinmobile.integrators import rk4
from pinmobile.parts import also_symbols, by_value, child, is_symbolic, part, structure
from pinmobile.plant import Step
from pinmobile.robot import BODY_JOINT, LOCKED, Linearization, Load, MobileRobot, Solids, number
from pinmobile.wheels.bearing import Bearing
from pinmobile.wheels.description import read_robot, read_wheels
from pinmobile.wheels.drawn import Tyres
from pinmobile.wheels.freedom import Allocation, Reduced
from pinmobile.wheels.ground import Coulomb, Ground, Rolling
from pinmobile.wheels.kinematics import Mobility
from pinmobile.wheels.motors import Beside, constant_force
from pinmobile.wheels.platform import Platform
from pinmobile.wheels.powered import ByVoltage
from pinmobile.wheels.rolling import RollingDynamics, stop_of
from pinmobile.wheels.rows import column
from pinmobile.wheels.table import WheelTable
from pinmobile.wheels.tree import ConstrainedTree, Forces, WheelTree

_OFF = 1e-9  # of a start's rates, beyond which it does not roll


@final
@part
@by_value
class WheeledRobot(Platform, Bearing):
    """A robot on wheels: q = (x, y, psi, arms, steering, wheels), u = torques at arms, wheels and axes.

    All methods broadcast over leading axes, and raise `InvalidArgument` for arguments of another last axis or
    that are not finite.

    Parameters
    ----------
    robot : MobileRobot
        The whole, wheels locked at their table angles: its mass, centre of mass and inertia hold the wheels'.
    table : WheelTable
        Its wheels; by default those of the file that it was read from, see `read_wheels`.
    ground : Rolling, Coulomb or other `Ground`, optional
        What it stands on; by default `Rolling` where the drive can roll without slip, else `Coulomb`.

    Raises
    ------
    InvalidArgument
        If an argument is something else, the wheels cannot roll on such ground, or the robot without them is
        no body.
    """

    robot: MobileRobot = child(MobileRobot, expected="a MobileRobot")
    table: WheelTable = child(WheelTable, expected="a WheelTable")
    ground: Any = child(Ground)
    broadcasts: ClassVar[bool] = True
    compiles: ClassVar[bool] = True
    integrator: ClassVar[Any] = rk4  # a lower order loses the way of a turn at speed

    def __init__(self, robot: MobileRobot, table: WheelTable | None = None, ground: Any = None) -> None:
        if table is None:
            table = read_wheels(robot)
        if ground is None:
            ground = Rolling() if Mobility.of(table).is_regular else Coulomb()
        self.__attrs_init__(robot, table, ground)  # type: ignore[attr-defined]

    def check(self) -> None:
        """Raise `InvalidArgument` where the ground cannot carry the robot."""
        if hasattr(self.ground, "check_robot"):
            self.ground.check_robot(self)

    @property
    def _rolls_ideally(self) -> bool:
        """Whether constraints hold the wheels, so that Pinocchio's tree under them gives the numbers."""
        return not getattr(self.ground, "slips", True)

    @cached_property
    def array_dynamics(self) -> Any:
        """Its dynamics on its ground, a `WheeledDynamics`, for one state, many, or symbols, unchecked."""
        return self.ground.dynamics(self)

    @property
    def law(self) -> Any:
        """What a loop calls: itself, or its `array_dynamics` where it holds symbols."""
        return self.array_dynamics if self._is_symbolic else self

    @cached_property
    def terms(self) -> dict[str, Any]:
        """Arguments of a `WheeledDynamics`, numbers or symbols, whatever the ground."""
        return {
            "robot": self.robot.array_dynamics,
            "table": self.table,
            **{name: getattr(self, name) for name in ("x", "y", "radius", "spin_inertia", "upright")},
            "mu": column([wheel.friction.mu for wheel in self.table.wheels]),
            "rotors": frozen([actuator.motor.reflected_inertia for actuator in self.table.actuators]),
            "fall": self._fall,
            "footprint": self.footprint,
            "stands": self.grounded and self._has_area,
            "choice": self.mobility.choice,
            "coordinates": self.coordinates,
            "inputs": self.inputs,
        }

    @cached_property
    def _rolling(self) -> RollingDynamics:
        """Its dynamics on ground where it rolls."""
        self._check_rolls()
        return self.array_dynamics if self._rolls_ideally else RollingDynamics(**self.terms)

    @property
    def mu(self) -> Array:
        """Coefficients of friction of the wheels, of rollers along their axes, shape (wheels,)."""
        return self.array_dynamics.mu  # type: ignore[no-any-return]

    @cached_property
    def upright(self) -> Any:
        """What the ground alone feels of a robot without arms, shape (3,) [m, kg m^2, kg m^2].

        Height of the centre of mass, and inertia xz and yz about it.
        """
        own = vars(self.robot).get("nominal")
        if own is None or own.mounts:
            return self._upright
        com, (height, xz, yz) = self.robot.com, self._upright
        z = com[2] if len(com) > 2 else 0.0
        if own.loads:
            whole, alone = own.lumped().mass, own.mass
            loads = whole * height - alone * (own.com[2] if len(own.com) > 2 else 0.0)
            z = (self.robot.mass * z + loads) / (self.robot.mass + (whole - alone))
        return column([z, xz, yz])

    @structure
    def _upright(self) -> Array:
        if self.robot.mounts:
            return frozen(np.zeros(3))
        inertia = self.robot.lumped().model.inertias[BODY_JOINT]
        return frozen([inertia.lever[2], inertia.inertia[0, 2], inertia.inertia[1, 2]])

    @cached_property
    def _tree(self) -> WheelTree:
        return WheelTree(self.robot, self.table, self._fall)

    @structure
    def joint_inertias(self) -> Array:
        """Diagonal of M at rest, of steering axes and wheels; it needs a body that is left without them."""
        return frozen(np.diagonal(self.mass_matrix(self.rest))[self.robot.nv :])

    @cached_property
    def _rolls(self) -> ConstrainedTree:
        """Its tree where wheels roll."""
        choice = self.mobility.choice
        independent = sorted({*choice.body, *(row for _, row in choice.joints)})
        few = replace(self._rows, rows=tuple(independent))
        return ConstrainedTree(self._tree, self._rows, few)

    @structure
    def _fall(self) -> Array:
        """Gravity along the axes of the plane, shape (3,) [m/s^2]."""
        g, ramp = np.array(self.robot.model.gravity.linear), getattr(self.ground, "ramp", None)
        return frozen(g) if ramp is None else ramp.fall(float(np.linalg.norm(g)))

    def __repr__(self) -> str:
        body = repr(self.robot).removesuffix(f" with {LOCKED}")
        return f"WheeledRobot({body}, {self.table!r}, {self.ground!r})"

    @classmethod
    def from_urdf(
        cls,
        path: str | PathLike[str],
        package_dirs: str | PathLike[str] | Sequence[str | PathLike[str]] = (),
        *,
        table: WheelTable | None = None,
        ground: Ground | None = None,
        ground_z: ArrayLike | None = None,
        **given: Any,
    ) -> Self:
        """Return the robot of a URDF on the wheels that it has; `source` says what was taken, what guessed.

        Parameters
        ----------
        path, package_dirs
            As in `MobileRobot.from_urdf`.
        table : WheelTable, optional
            Its wheels; by default those of the file.
        ground : Rolling or Coulomb, optional
            As in the class.
        ground_z : float, optional
            The ground's z in the frame of the root link [m]; by default as `MobileRobot.from_urdf` finds it,
            or where the file does not tell, below the wheels by the radii in `given`.
        **given
            What the file does not tell of its wheels, see `read_wheels`: ``radius``, ``rollers``, ``driven``,
            ``steering``, ``inertia``, ``locked``, ``supports``, ``couplings``.

        Raises
        ------
        InvalidArgument
            As `MobileRobot.from_urdf`, `read_wheels` and the class; or if both a table and `given` are there.
        """
        if table is not None and given:
            raise InvalidArgument(f"{next(iter(given))} is given with table=, expected one of the two")
        robot = read_robot(path, package_dirs, ground_z, given.get("radius"), given.get("locked", ()))
        wheels = read_wheels(robot, **given) if table is None else table
        return cls(robot, wheels, ground)

    def mount(self, arm: Any, at: ArrayLike | None = None, **options: Any) -> WheeledRobot:
        """Return the robot with an arm on its body: see `MobileRobot.mount`."""
        return WheeledRobot(self.robot.mount(arm, at, **options), self.table, self.ground)

    def attach(self, load: Load, frame: str | None = None) -> WheeledRobot:
        """Return the robot with a load fixed to one of its frames: see `MobileRobot.attach`."""
        return WheeledRobot(self.robot.attach(load, frame), self.table, self.ground)

    def by_voltage(self) -> ByVoltage:
        """Return the same robot whose input is volts, one per electric motor: see `ByVoltage`."""
        return ByVoltage(self)

    # Dynamics

    @cached_property
    def _tyres(self) -> Tyres:
        return Tyres(self.robot, self.table)

    @property
    def solids(self) -> Solids:
        """What of it may touch something, see `MobileRobot.solids`; wheels do touch the ground."""
        return self._tyres.solids

    @in_numbers
    def solid_placements(self, q: ArrayLike) -> Array:
        """Return where the shapes of `solids` are in the body's frame, shape (..., shapes, 4, 4)."""
        return self._tyres.placements(self._q(q))

    @property
    def end_effector(self) -> str:
        """Default frame: the tip of the first arm, or the body's frame where there is none."""
        return self.robot.end_effector

    @property
    def frame_names(self) -> tuple[str, ...]:
        """Names of the frames, see `MobileRobot.frame_names`."""
        return self.robot.frame_names

    def frame_name(self, frame: str | None = None) -> str:
        """Return the name of a frame, by default that of `end_effector`: see `MobileRobot.frame_name`."""
        return self.robot.frame_name(frame)

    def frame_pose(self, q: ArrayLike, frame: str | None = None) -> Array:
        """Return T_0_f, the pose of a frame, shape (..., 4, 4): see `MobileRobot.frame_pose`."""
        return self.robot.frame_pose(self._q(q)[..., : self.robot.nq], frame)

    @in_numbers
    def mass_matrix(self, q: ArrayLike) -> Array:
        """Return M(q), shape (..., nv, nv) [kg, kg m, kg m^2], by Pinocchio's CRBA, rotors included."""
        return self._tree.inertia(self._q(q))

    @in_numbers
    def nonlinear_effects(self, q: ArrayLike, v: ArrayLike) -> Array:
        """Return n(q, v), shape (..., nv) [N, N, N m, ...], by Pinocchio's RNEA."""
        q, v = self._q(q), self._v("v", v)
        broadcast(q=q, v=v)
        return self._tree.effects(q, v)

    @in_numbers
    def kinetic_energy(self, q: ArrayLike, v: ArrayLike) -> Array:
        """Return v' M(q) v / 2, shape (...) [J]."""
        q, v = self._q(q), self._v("v", v)
        broadcast(q=q, v=v)
        return np.asarray(np.einsum("...i,...ij,...j->...", v, self.mass_matrix(q), v) / 2)

    @also_symbols
    @in_numbers
    def forward_dynamics(self, q: ArrayLike, v: ArrayLike, u: ArrayLike, f: ArrayLike = 0.0) -> Array:
        """Return the acceleration, shape (..., nv) [m/s^2, ...].

        Of wheels that roll M a + n = B u + f + A' lambda and A a = -dA/dt v, solved together; where they
        slip, the mean over a short step, as dry friction has impulses and no force at an instant.

        Parameters
        ----------
        q, v : array_like, shape (..., nq), (..., nv)
            State, which rolls.
        u : array_like, shape (..., nu)
            Torques [N m], see `inputs`.
        f : array_like, shape (..., nv), optional
            Generalised forces beside them.
        """
        q, v, u, f = self._acted(q, v, u, f)
        if not self._rolls_ideally:
            return np.asarray(self.array_dynamics.forward_dynamics(q, v, u, f if f.ndim else 0.0))
        force = u @ self.input_matrix.T + f
        a = self._rolls.accelerations(q, v, force)
        return finite_answer(self._stopped(q, a, v), q=q, v=v, u=u, f=f)

    def _stopped(self, q: Array, values: Array, v: Array | None = None) -> Array:
        """Return velocities, or accelerations at `v`, less what stops of steering axes take of them."""
        for k, one in enumerate(self.table.axes):
            if np.isfinite(one.limit):
                axis, none = self.robot.nv + k, np.zeros(self.nv)
                own, rate = values[..., axis], 0.0 if v is None else v[..., axis]
                outward = np.asarray(stop_of(q[..., self.robot.nq + k], one.limit, rate))
                if not outward.any():
                    continue
                at_rest = self._rolls.accelerations(q, none, none)
                response = self._rolls.accelerations(q, none, np.eye(self.nv)[axis]) - at_rest
                size = np.where(outward * own > 0, own / response[..., axis], 0.0)
                values = values - response * size[..., None]
        return values

    def _acted(self, q: ArrayLike, v: ArrayLike, u: ArrayLike, f: ArrayLike) -> tuple[Array, ...]:
        """Check a state, an input and forces beside it."""
        q, v, u, f = self._q(q), self._v("v", v), vector("u", u, self.nu), self._f(f)
        if q.ndim > 1 or v.ndim > 1 or u.ndim > 1 or f.ndim > 1:
            broadcast(q=q, v=v, u=u, **({"f": f} if f.ndim else {}))
        return q, v, u, f

    @in_numbers
    def constraint_forces(self, q: ArrayLike, v: ArrayLike, u: ArrayLike, f: ArrayLike = 0.0) -> Forces:
        """Return the forces of the ground at the wheels, and which of them rolling determines."""
        if not self._rolls_ideally:
            raise InvalidArgument(
                "constraint_forces is asked of wheels that may slip, which no constraint holds, expected "
                "ground=Rolling(); their forces are in the signals of a run"
            )
        q, v, u, f = self._acted(q, v, u, f)
        a, values = self._rolls.forces(q, v, u @ self.input_matrix.T + f)
        finite_answer(a, q=q, v=v, u=u, f=f)
        return Forces(self.constraint_names, values, np.array(self.mobility.determined))

    # What the ground adds: a loop asks by name for what a plant can do

    def _of_ground(self, name: str) -> Any:
        """Return a method of the dynamics that not all grounds supply."""
        if not hasattr(self.array_dynamics, name):
            raise AttributeError(f"a WheeledRobot on {type(self.ground).__name__} ground has no {name}")
        return getattr(self.array_dynamics, name)

    @property
    def project(self) -> Callable[[ArrayLike, ArrayLike], Array]:
        """``project(q, v)``: the velocity that rolls and is nearest in the mass metric, shape (..., nv)."""
        own: Callable[[ArrayLike, ArrayLike], Array] = self._of_ground("project")
        return self._projected if self._rolls_ideally and not self._is_symbolic else own

    @in_numbers
    def _projected(self, q: ArrayLike, v: ArrayLike) -> Array:
        if is_symbolic(q) or is_symbolic(v):
            return self.array_dynamics.project(q, v)  # type: ignore[no-any-return]
        q = self._q(q)
        return self._stopped(q, self._rolls.project(q, self._v("v", v)))

    @also_symbols
    @in_numbers
    def reduced(self, q: ArrayLike, v: ArrayLike) -> Reduced:
        """Return the dynamics of the independent velocities, of Pinocchio's tree: see `Reduced`.

        Parameters
        ----------
        q, v : array_like, shape (..., nq), (..., nv)
            State, which rolls.
        """
        q, v = self._q(q), self._v("v", v)
        lead = broadcast(q=q, v=v)
        q, v = (np.broadcast_to(x, (*lead, x.shape[-1])) for x in (q, v))
        rolling = self._rolling
        state = rolling.state(q, v)
        S, gamma = rolling.freedom.solution(state)
        columns = np.stack([rolling.in_plane(state, list(column), q) for column in zip(*S, strict=True)], -1)
        drift = rolling.in_plane(state, rolling.freedom.unmoved(state, S, gamma), q)
        M, n = self.mass_matrix(q), self.nonlinear_effects(q, v)
        n = n + np.einsum("...ij,...j->...i", M, drift)
        S_T = np.swapaxes(columns, -1, -2)
        nu = np.stack(np.broadcast_arrays(q[..., 0], *map(number, rolling.freedom.velocities(state)))[1:], -1)
        return Reduced(
            S_T @ M @ columns, np.einsum("...ij,...j->...i", S_T, n), S_T @ self.input_matrix, columns, nu
        )

    @also_symbols
    @in_numbers
    def inverse_dynamics(self, q: ArrayLike, v: ArrayLike, a: ArrayLike) -> Array:
        """Return the input of least norm with which body and arms accelerate so, shape (..., nu) [N m].

        ``forward_dynamics(q, v, inverse_dynamics(q, v, a))`` begins with `a`; the inverse does not hold where
        there are more inputs than coordinates.

        Parameters
        ----------
        q, v : array_like, shape (..., nq), (..., nv)
            State, which rolls.
        a : array_like, shape (..., 3 + arms)
            Acceleration of x, y, psi and the arms [m/s^2, rad/s^2, ...].

        Raises
        ------
        InvalidArgument
            If the drive cannot accelerate its body in every direction.
        """
        self.check_inverse_dynamics()
        q, v, a = self._q(q), self._v("v", v), vector("a", a, self.robot.nv)
        lead = broadcast(q=q, v=v, a=a)
        q, v, a = (np.broadcast_to(x, (*lead, x.shape[-1])) for x in (q, v, a))
        own = self.reduced(q, v)
        c, s = np.cos(q[..., 2]), np.sin(q[..., 2])
        wanted = [
            c * a[..., 0] + s * a[..., 1],
            c * a[..., 1] - s * a[..., 0],
            *np.moveaxis(a[..., 2:], -1, 0),
        ]
        # Rates of the body twist, which turns with the body.
        w, ahead, aside = (own.nu[..., k] for k in (2, 0, 1))
        wanted[:2] = [wanted[0] + w * aside, wanted[1] - w * ahead]
        return own.torques(np.stack(wanted, axis=-1))

    def check_inverse_dynamics(self) -> None:
        """Refuse a drive that cannot accelerate its body in every direction.

        Raises
        ------
        InvalidArgument
            With the drive's type, and what to take instead.
        """
        lead = f"robot is {self.mobility.kind}"
        if self.mobility.mobility < 3:
            raise InvalidArgument(
                f"{lead}, which cannot accelerate in every direction, so no torques are its inverse "
                "dynamics; expected an omnidirectional drive, or Backstepping(law, robot)"
            )
        still = self.reduced(self.rest, np.zeros(self.nv))
        if np.linalg.matrix_rank(still.B) < len(still.M):
            raise InvalidArgument(
                f"{lead} with {len(self.table.actuators)} motors, which cannot accelerate in every "
                "direction; expected a motor for each degree of freedom"
            )

    @also_symbols
    @in_numbers
    def independent(self, q: ArrayLike, v: ArrayLike) -> Array:
        """Return the independent velocities nu of a state that rolls, shape (..., m): see `Reduced`."""
        q, v = self._q(q), self._v("v", v)
        lead = broadcast(q=q, v=v)
        nu = map(number, self._rolling.freedom.velocities(self._rolling.state(q, v)))
        return np.stack([np.broadcast_to(x, lead) for x in nu], axis=-1)

    @also_symbols
    @in_numbers
    def linearize_tracked(self, q: ArrayLike, v: ArrayLike, u: ArrayLike) -> Linearization:
        """Return the first-order model of the tracked state, d(e, dnu)/dt = A (e, dnu) + B du.

        e has x, y, psi and the arms, as `difference` has them, and nu the independent velocities: see
        `Reduced`. Angles of wheels that do not steer do not matter. Slopes are by the complex step, exact but
        for rounding.

        Parameters
        ----------
        q, v : array_like, shape (..., nq), (..., nv)
            State, which rolls.
        u : array_like, shape (..., nu)
            Torques [N m].

        Raises
        ------
        InvalidArgument
            If wheels steer, or an argument has another shape.
        """
        q, v, u, _ = self._acted(q, v, u, 0.0)
        return Linearization(*self._rolling.linearize_tracked(q, v, u))

    @also_symbols
    @in_numbers
    def torques(self, q: ArrayLike, v: ArrayLike, rates: ArrayLike) -> Array:
        """Return the input of least norm with which independent velocities change so, shape (..., nu) [N m].

        Parameters
        ----------
        q, v : array_like, shape (..., nq), (..., nv)
            State, which rolls.
        rates : array_like, shape (..., m)
            nu' of `Reduced` [m/s^2, rad/s^2].
        """
        own = self.reduced(q, v)
        return own.torques(vector("rates", rates, own.nu.shape[-1]))

    @cached_property
    def pivots(self) -> Any:
        """Where each axis steers a wheel, x, y, and its angle at zero, shape (axes, 3) [m, m, rad].

        Of an Ackermann pair it is the wheel in their middle.
        """
        if not self.table.axes:
            return frozen(np.zeros((0, 3)))
        found = self.array_dynamics.pivots
        return found if self._is_symbolic else frozen(found)

    @in_numbers
    def allocate(self, q: ArrayLike, tau: ArrayLike) -> Allocation:
        """Return the torques within limits that come nearest to a force on body and arms.

        Where limits allow it they change the independent velocities as the force would, and have least norm;
        else the sum of squares of what they miss is least in the metric of the inverse mass, by a quadratic
        program. `allocate_scaled` is for loops.

        Parameters
        ----------
        q : array_like, shape (..., nq)
            Configuration.
        tau : array_like, shape (..., 3 + arms)
            Force on x, y, psi and the arms [N, N, N m, ...].
        """
        q, tau = self._q(q), vector("tau", tau, self.robot.nv)
        lead = broadcast(q=q, tau=tau)
        q, tau = (np.broadcast_to(x, (*lead, x.shape[-1])) for x in (q, tau))
        u, rest = np.empty((*lead, self.nu)), np.empty((*lead, self.robot.nv))
        for at in np.ndindex(lead):
            own = self.reduced(q[at], np.zeros(self.nv))
            u[at] = own.nearest(own.S[: self.robot.nv].T @ tau[at], self.inputs)
            rest[at] = self._missed(q[at], tau[at], u[at])
        return Allocation(u, rest)

    def _missed(self, q: Array, tau: Array, u: Array) -> Array:
        """Return what of a force the wheels and joints do not supply, shape (..., 3 + arms)."""
        state = self.array_dynamics.state(q, np.zeros(self.nv))
        had = np.array([number(x) for x in self.array_dynamics.freedom.supplied(state, u)])
        x, y = had[:2].copy()
        had[:2] = state.c * x - state.s * y, state.s * x + state.c * y
        return np.asarray(tau - had)

    @also_symbols
    @in_numbers
    def allocate_scaled(self, q: ArrayLike, tau: ArrayLike) -> tuple[Array, Array]:
        """Return torques for a force on body and arms, scaled by one factor into limits, and what is left.

        They have least norm; where one is beyond its limit all shrink alike, so that the force keeps its
        direction. It is the same arithmetic in all engines.

        Parameters
        ----------
        q : array_like, shape (..., nq)
            Configuration.
        tau : array_like, shape (..., 3 + arms)
            Force on x, y, psi and the arms [N, N, N m, ...].
        """
        q, tau = self._q(q), vector("tau", tau, self.robot.nv)
        lead = broadcast(q=q, tau=tau)
        q, tau = (np.broadcast_to(x, (*lead, x.shape[-1])) for x in (q, tau))
        u, left = self._rolling.allocate_scaled(q, tau)
        return np.asarray(u), np.asarray(left)

    def start(self, reference: Any) -> tuple[Array, Array]:
        """Return the q and v with which a reference begins, shape (nq,) and (nv,).

        Steered wheels point to where they go, and all roll; what the reference leaves out of the arms rests.
        """
        return self.array_dynamics.begun(*self.robot.start(reference))  # type: ignore[no-any-return]

    @property
    def initial_state(self) -> Callable[[Any], Any]:
        """``initial_state(context)``: what the wheels keep before the first step, where they slip."""
        return self._of_ground("initial_state")  # type: ignore[no-any-return]

    @property
    def step(self) -> Callable[..., Step]:
        """``step(t, q, v, u, h, f, memory)``: the state a step later, where wheels slip.

        ``f(t, q, v)`` has the generalised forces beside the input, at mid-step; an array has those that stay.
        """
        own: Callable[..., Step] = self._of_ground("step")
        return own if self._is_symbolic else self._stepped

    @property
    def signals(self) -> Callable[..., dict[str, tuple[str, Any]]]:
        """``signals(t, q, v, u, f, memory)``: what the ground does at the wheels, where they slip."""
        return self._of_ground("signals")  # type: ignore[no-any-return]

    def _stepped(
        self,
        t: float,
        q: ArrayLike,
        v: ArrayLike,
        u: ArrayLike,
        h: float,
        f: Beside | ArrayLike,
        memory: Any,
    ) -> Step:
        if is_symbolic(q) or is_symbolic(v) or is_symbolic(u):
            answer: Step = self.array_dynamics.step(t, q, v, u, h, f, memory)
            return answer
        q, v, u = self._q(q), self._v("v", v), vector("u", u, self.nu)
        beside = f if callable(f) else constant_force(self._f(f))
        h = positive("h", h, "s")
        if not isinstance(memory, getattr(self.array_dynamics, "memory", object)):
            raise InvalidArgument(
                f"memory is {shown(memory)}, expected what initial_state or a step returned"
            )
        return self.array_dynamics.step(t, q, v, u, h, beside, memory)  # type: ignore[no-any-return]

    def check_start(self, q: ArrayLike, v: ArrayLike) -> None:
        """Refuse a start at which wheels on one gear train turn at different rates, or those that roll slip.

        Raises
        ------
        InvalidArgument
            If it is such.
        """
        q, v = self._q(q), self._v("v", v)
        broadcast(q=q, v=v)
        A = self.constraint_matrix(q)
        with np.errstate(all="ignore"):
            slips = finite_answer((A @ v[..., None])[..., 0], q=q, v=v)
        names, off = self.constraint_names, np.abs(slips).reshape(-1, A.shape[-2]).max(axis=0, initial=0.0)
        for name, slip in zip(names, off, strict=True):
            if (not self._rolls_ideally and name != "train") or slip <= _OFF * (1 + float(np.abs(v).max())):
                continue
            if not self._rolls_ideally:
                raise InvalidArgument(
                    f"start turns wheels of a gear train at different rates, {slip:.3g} m/s apart; expected "
                    "v0 in which they turn together"
                )
            raise InvalidArgument(
                f"start does not roll: {name} slips at {slip:.3g} m/s; expected a reference that "
                "the wheels can follow, such as Tangent(path), v0 = robot.project(q0, v0), or v0 of zeros"
            )
