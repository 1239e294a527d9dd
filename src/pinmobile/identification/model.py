"""`PlanarModel`: a robot in the plane as its log sees it, linear in what is identified.

The body twist is nu = S eta with free velocities eta: of a body that is pushed S is the identity, of wheels
that roll without steering it is constant. With phi = (m, m x, m y, I | c | f), I about the body's origin,
friction along the axes A eta, and what the wheels' own inertia adds, M_w::

    S' [ m a_u - m x r^2 - m y r'   ]
       [ m a_w + m x r' - m y r^2   ] + M_w eta' + A' (c A eta + f A eta / sqrt((A eta)^2 + e^2)) = F
       [ m x a_w - m y a_u + I r'   ]

with a_u = u' - r w and a_w = w' + r u. F is R(psi)' u of a body that is pushed, and B tau of wheels, u or tau
less constant offsets where these are identified; tau are the torques: the input, or what motors make of volts
and the wheels' rates by their law, limits and losses in the gear as they are stated. Where the input's scale
is identified, torque constants have it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache, partial
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pinmobile import parts
from pinmobile.arrays import Array, bounded, frozen, scalar
from pinmobile.compiled import vectorize
from pinmobile.errors import InvalidArgument, shown
from pinmobile.forces import JointFriction, RollingResistance, ViscousFriction
from pinmobile.identification.estimator import Segments, differences, runge_kutta, solve
from pinmobile.identification.log import Log
from pinmobile.identification.preprocessing import LATER, PreprocessedLog
from pinmobile.identification.statistics import POSE
from pinmobile.robot import MobileRobot, solved
from pinmobile.urdf import Body
from pinmobile.wheels import Motor, MotorLaw

if TYPE_CHECKING:
    from pinmobile.identification.result import Identification

_CONSTANTS = "resistance", "torque_constant", "viscous", "coulomb", "efficiency"
_STILL = 2e-3  # [rad/s], where losses of a motor have 71 % of their size; those of real ones are sharp
_STEP, _RUBBING_STEP = 5e-3, 1e-3  # [s], longest of an integration: friction changes its sign within some
_GYRATION = 0.01  # [m], least radius of a body
_LIGHTEST = 0.02  # [kg]
_NOTHING = 1e-14  # of the largest variance
_ROUNDED = 1e-6  # of what a bound lacks
_STEPS = 200  # of a search for a body, of which some ten are needed
_SHIFT = 1e-5  # of a parameter's scale, in differences
_AHEAD = 2.0  # [s]
_DENSITIES = 20.0, 2e4  # [kg/m^2], mass per square of the radius of gyration; of boxes 12 m / (a^2 + b^2)
_LEAST_RESPONSE = 1e-3  # to an input, as a share of the largest
_RESPONSES = 3  # of a sensor, as the heading turns them
_AXES = "forward", "left", "yaw"
_FRICTIONS: tuple[tuple[tuple[str, str, str, Any], ...], ...] = (  # of a body that is pushed, of wheels
    (
        ("viscous", "coefficients", "viscous friction, ", ("N s/m", "N s/m", "N m s")),
        ("rolling", "force", "rolling resistance, ", ("N", "N", "N m")),
    ),
    (
        ("joint_viscous", "viscous", "friction of ", "N m s/rad"),
        ("joint_coulomb", "coulomb", "dry friction of ", "N m"),
    ),
)


class Quantity(NamedTuple):
    """One of the numbers that are identified.

    Attributes
    ----------
    name, unit, meaning : str
        What it is called.
    bounded : bool
        Whether it cannot be below zero.
    path : str
        What a spread calls it.
    """

    name: str
    unit: str
    meaning: str
    bounded: bool
    path: str = ""


@dataclass(frozen=True, eq=False)
class PlanarModel:
    """A robot in the plane, linear in what is identified.

    Attributes
    ----------
    S : ndarray, shape (3, k)
        Body twist of the free velocities.
    A : ndarray, shape (a, k)
        Rates along which there is friction: the body's axes, or the driven wheels.
    B : ndarray, shape (k, nu), or None
        Force of the inputs on the free velocities; None: the input is a force in the inertial frame.
    inertia : ndarray, shape (k, k)
        What turning wheels add to the mass matrix, known.
    speed : float
        Where dry friction has 71 % of its size.
    wheels : tuple of str
        Names of the driven wheels, whose friction it is; empty of a body that is pushed.
    scaled : bool
        Whether the input's scale is identified too, the last entry of phi.
    motors : tuple of Motor
        Of each input, where any takes volts; else empty.
    offset : bool
        Whether phi has, behind the friction, a constant force or torque by which each input reads too much.
    """

    S: Array
    A: Array
    B: Array | None
    inertia: Array
    speed: float
    wheels: tuple[str, ...] = ()
    scaled: bool = False
    motors: tuple[Motor, ...] = ()
    offset: bool = False

    measured: ClassVar[tuple[tuple[str, str], ...]] = POSE
    told_first: ClassVar[int] = 4

    @classmethod
    def pushed(cls, speed: float, scaled: bool = False) -> PlanarModel:
        """Return the body that is pushed by forces."""
        eye, nothing = frozen(np.eye(3)), frozen(np.zeros((3, 3)))
        return cls(eye, eye, None, nothing, speed, scaled=scaled)

    @classmethod
    def rolling(cls, robot: Any, speed: float, scaled: bool = False) -> PlanarModel:
        """Return a robot on wheels that roll and do not steer, by torques or by volts.

        Raises
        ------
        InvalidArgument
            If its wheels steer, slip, or share a motor, or it has arms.
        """
        table = robot.table
        kinds = {
            "wheels that steer": bool(table.axes),
            "wheels that slip": robot.ground.slips,
            "motors that turn several wheels": bool(table.couplings),
            "arms": bool(robot.mounts),
        }
        what = next((name for name, is_so in kinds.items() if is_so), "")
        if what:
            raise InvalidArgument(
                f"robot is {shown(robot)}, with {what}, expected wheels that roll and do not steer, on a "
                "motor each and without arms: such as those of a differential, mecanum or omni drive"
            )
        reduced = robot.reduced(robot.rest, np.zeros(robot.nv))
        S, turning = reduced.S[:3], reduced.S[3:]
        names = tuple(each.name for each in table.actuators)
        inertia = reduced.M - S.T @ robot.robot.mass_matrix(np.zeros(3)) @ S
        columns = np.stack([each.column for each in table.actuators], axis=-1)
        volts = any(each.unit == "V" for each in robot.inputs)
        motors = tuple(each.motor for each in table.actuators) if volts else ()
        S, A, B, inertia = (frozen(each) for each in (S, columns.T @ turning, reduced.B, inertia))
        return cls(S, A, B, inertia, speed, names, scaled, motors)

    @property
    def free(self) -> int:
        """How many free velocities there are."""
        return int(self.S.shape[1])

    @property
    def nu(self) -> int:
        """Size of the input."""
        return 3 if self.B is None else int(self.B.shape[1])

    @property
    def inputs(self) -> dict[str, str]:
        """Units of the inputs by name."""
        if not self.wheels:
            return {"Fx": "N", "Fy": "N", "Mz": "N m"}
        electric = [each.is_electric for each in self.motors] or [False] * len(self.wheels)
        return {n: "V" if volts else "N m" for n, volts in zip(self.wheels, electric, strict=True)}

    @cached_property
    def quantities(self) -> tuple[Quantity, ...]:
        """What is identified, as it is told: the centre of mass and the inertia about it."""
        rolls = bool(self.wheels)
        found = [
            Quantity("mass", "kg", "mass", True, "mass"),
            Quantity("com_x", "m", "centre of mass forward", False, "com.x"),
            Quantity("com_y", "m", "centre of mass to the left", False, "com.y"),
            Quantity("yaw_inertia", "kg m^2", "yaw inertia about the centre of mass", True, "yaw_inertia"),
        ]
        for name, path, meaning, unit in _FRICTIONS[rolls]:
            axes = dict.fromkeys(self.wheels, unit) if rolls else dict(zip(_AXES, unit, strict=True))
            found += [
                Quantity(f"{name}_{n}", each, meaning + n, True, f"{path}.{n}") for n, each in axes.items()
            ]
        if self.offset:
            units = ["N m"] * self.nu if rolls else self.inputs.values()
            pairs = zip(self.inputs, units, strict=True)
            found += [Quantity(f"offset_{n}", unit, f"constant offset of {n}", False) for n, unit in pairs]
        if self.scaled:
            found.append(Quantity("input_scale", "", "scale of inputs or torque constants as stated", True))
        return tuple(found)

    @property
    def size(self) -> int:
        """How many numbers phi has."""
        return 4 + 2 * len(self.A) + self.nu * self.offset + self.scaled

    @property
    def dry(self) -> slice:
        """Where phi has dry friction."""
        return slice(4 + len(self.A), 4 + 2 * len(self.A))

    @property
    def offsets(self) -> slice:
        """Where phi has offsets of the inputs."""
        return slice(self.dry.stop, self.size - self.scaled)

    @property
    def longest_step(self) -> float:
        """Longest step with which motions are to be integrated [s]."""
        rubs = any(each.coulomb or each.efficiency < 1 for each in self.motors)
        return _RUBBING_STEP if rubs else _STEP

    def to_physical(self, phi: Array) -> Array:
        """Return what is told of phi, shape (..., p): com = (m x, m y) / m, and the inertia about it."""
        m, mx, my, inertia = (phi[..., k] for k in range(4))
        about = inertia - (mx * mx + my * my) / m
        return np.concatenate([np.stack([m, mx / m, my / m, about], -1), phi[..., 4:]], -1)

    def phi(self, told: Array) -> Array:
        """Return phi of what is told, shape (..., p)."""
        m, x, y, about = (told[..., k] for k in range(4))
        first = np.stack([m, m * x, m * y, about + m * (x * x + y * y)], -1)
        return np.concatenate([first, told[..., 4:]], -1)

    def slopes(self, phi: Array) -> Array:
        """Return the derivatives of what is told by phi, shape (p, p)."""
        m, mx, my = phi[:3]
        D = np.eye(len(phi))
        D[1, :2] = -mx / m**2, 1 / m
        D[2, [0, 2]] = -my / m**2, 1 / m
        D[3, :4] = (mx * mx + my * my) / m**2, -2 * mx / m, -2 * my / m, 1.0
        return D

    def are_possible(self, phi: Array) -> Any:
        """Return whether mass and yaw inertia about the centre of mass are above zero, of phi (..., p)."""
        m, mx, my, inertia = (phi[..., k] for k in range(4))
        return (m > 0) & (m * inertia > mx * mx + my * my)

    def possible(self, phi: Array, scales: Array) -> Array:
        """Return parameters of a body, those given where they are: else with a small mass or inertia."""
        told = np.array(phi)
        told[0] = max(told[0], 1e-2 * scales[0])
        about = (told[1] ** 2 + told[2] ** 2) / told[0]
        told[3] = max(told[3], about + 1e-2 * scales[3])
        return told

    def plausible(self, phi: Array, covariance: Array) -> Array:
        """Return the likeliest parameters of a body whose friction brakes: phi itself if it is one.

        That is min (p - phi)' C^-1 (p - phi) with friction and scale not below zero, and the linear matrix
        inequality of a body of radius of gyration rho and more::

            [ I - rho^2 m  m x  m y ]
            [ m x          m    0   ]  >= 0
            [ m y          0    m   ]

        Both are convex. Where the covariance C has nothing, nothing moves.

        Raises
        ------
        InvalidArgument
            If there is none.
        """
        from scipy.optimize import minimize  # here, because it takes long to load

        friction = [k for k, one in enumerate(self.quantities) if one.bounded and k > 3]

        def slack(p: Array) -> Array:
            return np.concatenate([[p[0] - _LIGHTEST, _inertia_left(p)], p[friction]])

        if (slack(phi) >= 0).all():
            return phi
        values, vectors = np.linalg.eigh(covariance)
        told = values > _NOTHING * values.max()
        root = vectors[:, told] * np.sqrt(values[told])
        size = np.abs(slack(phi)) + 1e-3 * np.abs(phi).max()
        found = minimize(
            lambda z: (z @ z / 2, z),
            np.zeros(root.shape[1]),
            jac=True,
            method="SLSQP",
            constraints={"type": "ineq", "fun": lambda z: slack(phi + root @ z) / size},
            options={"ftol": _ROUNDED**2, "maxiter": _STEPS},
        )
        body = phi + root @ found.x
        if not (slack(body) >= -_ROUNDED * size).all():
            raise InvalidArgument(
                f"log leads to a mass of {phi[0]:.3g} kg and a yaw inertia of {self.to_physical(phi)[3]:.3g} "
                "kg m^2, of which there is no body near: expected a log that tells them to be above zero"
            )
        body[3] += max(0.0, -_inertia_left(body))
        body[friction] = np.maximum(body[friction], 0.0)
        return np.asarray(body)

    @property
    def stated_constants(self) -> Array:
        """Torque constants of the motors as stated where their scale is identified, shape (motors,)."""
        return np.array([each.torque_constant for each in self.motors] if self.scaled else [])

    def robot(self, found: Identification) -> Any:
        """Return the robot as identified; see `Identification.robot`."""
        m, x, y, inertia = self.to_physical(found.plausible)[:4].tolist()
        prior = found.prior
        if prior is None:
            return MobileRobot(m, inertia, com=(x, y))
        bare = (prior.robot if self.wheels else prior).lumped()
        new = bare.with_body(_body(bare.body, m, (x, y), inertia), f"{bare.source}; identified from a log")
        if not self.wheels:
            return new
        if not self.motors:
            return parts.evolved(prior, robot=new)
        driven = parts.evolved(prior.wheeled, robot=new).by_voltage()
        if self.scaled:
            constants = zip(driven.motor_paths, found.torque_constants, strict=True)
            driven = parts.replace(driven, {f"{path}.torque_constant": k for path, k in constants})
        return driven

    def forces(self, found: Identification) -> list[Any]:
        """Return the friction for `simulate`; see `Identification.forces`."""
        viscous, dry = np.split(self.to_physical(found.plausible)[4 : self.dry.stop], 2)
        if not self.wheels:
            return [ViscousFriction(viscous), RollingResistance(dry, self.speed)]
        names = [one.name for one in found.prior.coordinates]
        columns = np.zeros((2, len(names)))
        columns[:, [names.index(name) for name in self.wheels]] = viscous, dry
        return [JointFriction(columns[0], columns[1], self.speed, names)]

    def notes(self, found: Identification) -> tuple[str, ...]:
        """Return what a log of such a robot cannot tell, and what is odd of the estimates."""
        mass, _, _, inertia = self.to_physical(found.phi)[:4].tolist()
        told = []
        if not self.offset:
            told.append("the motion does not tell constant offsets of inputs from friction: taken as zero")
        seen = found.is_seen["mass"] and found.is_seen["yaw_inertia"]
        if seen and min(mass, inertia) > 0 and not _DENSITIES[0] < mass**2 / inertia < _DENSITIES[1]:
            told.append(
                f"a mass of {mass:.3g} kg with a radius of gyration of {np.sqrt(inertia / mass):.2g} m is "
                f"implausible: robots have {_DENSITIES[0]:g} to {_DENSITIES[1]:g} kg per square metre of it; "
                "are inputs in N and N m, positions in m?"
            )
        if not self.wheels:
            return tuple(told)
        if found.slippage is not None and found.slippage.matters:
            told.append(str(found.slippage))
        told.append(
            "of mass and yaw inertia the wheels' own inertia cannot be told: "
            f"{self.inertia[0, 0]:.3g} kg and {self.inertia[-1, -1]:.3g} kg m^2 of it were taken as stated"
        )
        if not self.scaled:
            told.append(
                "all of this hangs on the torque per input, which was taken as stated: a log with a known "
                "load tells it, identify([log, loaded], robot, loads=[None, load])"
            )
        if self.motors:
            told.append(
                "motors were taken as stated"
                + (" but for one scale of all their torque constants" if self.scaled else "")
                + ", with their friction and gears; friction is what these leave"
            )
        return tuple(told)

    def predicted(
        self, found: Identification, log: Log, seconds: float | None
    ) -> tuple[Segments, Array, NDArray[np.bool_], Array]:
        """Return segments of a log, measured less simulated, which samples count, and the sensors' noise."""
        run = PreprocessedLog.of(log, self, np.zeros(4))
        late, longest = found.delay / run.dt, len(run.q) * run.dt - 2 * abs(found.delay) - 4 * run.dt
        length = scalar("seconds", _AHEAD if seconds is None else seconds)
        ahead = bounded("seconds", length, least=10 * run.dt, most=longest, unit="s")
        segments = run.segments(self, late, ahead, run.rates is not None)
        search = Search(self, found.phi, np.zeros((len(found.phi), 0)), late)
        return segments, solve(search, segments, search.start).near.residual, segments.good, run.noise

    def rows(self, a_u: Array, a_w: Array, turn: Array, square: Array, rates: Array, dry: Array) -> Array:
        """Return the regressor along the free velocities, shape (n, k, p), a scale of the input left out.

        Parameters
        ----------
        a_u, a_w : ndarray, shape (n,)
            Acceleration forward and to the left.
        turn, square : ndarray, shape (n,)
            r' and r^2.
        rates, dry : ndarray, shape (n, a)
            Rates with friction, and their regularised signs.
        """
        zero = np.zeros_like(a_u)
        body = np.stack(
            [
                np.stack([a_u, -square, -turn, zero], -1),
                np.stack([a_w, turn, -square, zero], -1),
                np.stack([zero, a_w, -a_u, turn], -1),
            ],
            axis=1,
        )
        inertial = np.einsum("ai,naj->nij", self.S, body)
        friction = [part[:, None, :] * self.A.T[None] for part in (rates, dry)]
        return np.concatenate([inertial, *friction], axis=-1)

    def regressor(self, eta: Array, rate: Array) -> Array:
        """Return the regressor of free velocities and their derivatives, both (n, k), shape (n, k, p)."""
        (forward, left, r), (du, dw, turn) = (eta @ self.S.T).T, (rate @ self.S.T).T
        rates = eta @ self.A.T
        dry = rates / np.hypot(rates, self.speed)
        return self.rows(du - r * left, dw + r * forward, turn, r * r, rates, dry)

    def torques(self, u: Sequence[Any], rates: Sequence[Any], scale: Any = 1.0) -> list[Any]:
        """Return the torques of the inputs at rates of their wheels, in numbers, arrays or symbols.

        Parameters
        ----------
        u, rates : sequence, shape (nu,)
            Inputs and rates [rad/s].
        scale : scalar
            Of torques per input; of motors, of their torque constants.
        """
        if not self.motors:
            return [scale * x for x in u]
        numbers = np.array([[getattr(one, name) or 0.0 for one in self.motors] for name in _CONSTANTS])
        resistance, constant, viscous, coulomb, efficiency = numbers
        law = MotorLaw(self.motors, resistance, scale * constant, viscous, coulomb, efficiency)
        return [
            law.smooth_torque(k, law.volts(k, x), rate, rate / np.sqrt(rate * rate + _STILL**2))
            if motor.is_electric
            else scale * x
            for k, (motor, x, rate) in enumerate(zip(self.motors, u, rates, strict=True))
        ]

    def acceleration(self, psi: Any, eta: Any, u: Any, phi: Any) -> Any:
        """Return eta', shape (k,), of one state, in numbers or symbols."""
        m, mx, my, inertia = phi[0], phi[1], phi[2], phi[3]
        forward, left, r = (_dot(row, eta) for row in self.S)
        h = (m * r * left + mx * r * r, my * r * r - m * r * forward, -(mx * r * forward + my * r * left))
        rates = [_dot(row, eta) for row in self.A]
        count = len(rates)
        rubbing = [
            phi[4 + j] * rate + phi[4 + count + j] * rate / np.sqrt(rate * rate + self.speed**2)
            for j, rate in enumerate(rates)
        ]
        scale = phi[self.size - 1] if self.scaled else 1.0
        torques = [scale * each for each in u] if self.B is None else self.torques(u, rates, scale)
        if self.offset:
            torques = [each - phi[self.dry.stop + j] for j, each in enumerate(torques)]
        if self.B is None:
            (x, y, moment), c, s = torques, np.cos(psi), np.sin(psi)
            force = [c * x + s * y, c * y - s * x, moment]
        else:
            force = [_dot(row, torques) for row in self.B]
        body = (0, 0, m), (1, 1, m), (0, 2, -my), (2, 0, -my), (1, 2, mx), (2, 1, mx), (2, 2, inertia)
        k = self.free
        right = [force[i] + _dot(self.S[:, i], h) - _dot(self.A[:, i], rubbing) for i in range(k)]
        M: list[list[Any]] = [[float(self.inertia[i, j]) for j in range(k)] for i in range(k)]
        for i, j in np.ndindex(k, k):
            for a, b, entry in body:
                factor = float(self.S[a, i] * self.S[b, j])
                if factor:
                    M[i][j] = M[i][j] + factor * entry
        return solved(M, right, range(k))

    def step(self, z: Any, first: Any, then: Any, phi: Any, spans: Any, *, steps: tuple[int, int]) -> Any:
        """Return the state a while later, shape (3 + k,), by Runge's and Kutta's fourth order.

        Parameters
        ----------
        z : shape (3 + k,)
            Pose and free velocities.
        first, then : shape (nu,)
            Inputs, each of which is held for a part of the while.
        phi : shape (p,)
            What is identified.
        spans : shape (2,)
            How long a step of each part is [s].
        steps : tuple of 2 int
            How many steps each part has.
        """
        for u, span, count in zip((first, then), (spans[0], spans[1]), steps, strict=True):
            z = runge_kutta(partial(self._rate, u, phi), z, span, count)
        return z

    def _rate(self, u: Any, phi: Any, state: Any) -> Any:
        psi, eta = state[2], [state[3 + i] for i in range(self.free)]
        forward, left, r = (_dot(row, eta) for row in self.S)
        c, s = np.cos(psi), np.sin(psi)
        way = [c * forward - s * left, s * forward + c * left, r]
        return np.stack([*way, *self.acceleration(psi, eta, u, phi)])


@lru_cache(32)
def _stepped(model: PlanarModel, steps: tuple[int, int]) -> Callable[..., Array]:
    """Return `PlanarModel.step` of many states, compiled."""
    return vectorize(partial(model.step, steps=steps), checked=False)


@dataclass(frozen=True, eq=False)
class Search:
    """Numbers of a planar model that output error seeks: steps in some directions, and the delay.

    Parameters
    ----------
    model : PlanarModel
        The robot.
    base : ndarray, shape (p,)
        Where all steps are zero.
    basis : ndarray, shape (p, d)
        Directions, each of the size that is expected.
    delay : float
        By which poses come late, in samples.
    free : bool
        Whether the delay is sought too: then it is the last number.
    """

    model: PlanarModel
    base: Array
    basis: Array
    delay: float
    free: bool = False

    @property
    def start(self) -> Array:
        """The first numbers, shape (P,)."""
        return np.zeros(self.basis.shape[1] + self.free)

    def sizes(self, p: Array) -> Array:
        """Return the sizes of the numbers, shape (P,)."""
        return np.ones(len(p))

    def values(self, p: Array) -> tuple[Array, Array]:
        """Return parameters, shape (..., p), and delays, shape (...), of numbers (..., P)."""
        late = self.delay + (p[..., -1] if self.free else np.zeros(p.shape[:-1]))
        return self.base + p[..., : self.basis.shape[1]] @ self.basis.T, late

    def is_possible(self, p: Array) -> bool:
        """Return whether there is a body of such numbers, about as late as at first."""
        phi, late = self.values(p)
        return bool(self.model.are_possible(phi) and abs(late - self.delay) < LATER)

    def linearize(self, segments: Segments, p: Array, starts: Array) -> tuple[Array, Array]:
        """Return the simulation and its slopes, those by the delay over whole samples."""
        steps = np.append(np.full(self.basis.shape[1], _SHIFT), [1.0] * self.free)
        return differences(self, segments, p, starts, steps)

    @np.errstate(all="ignore")  # where a robot that is tried runs away
    def simulate(self, segments: Segments, p: Array, starts: Array) -> Array:
        """Return the poses, and rates of wheels where they are measured, shape (V, S, L, m)."""
        phi, late = self.values(p)
        body = np.repeat(phi[:, None], len(segments.y), axis=1)
        body[..., :4] += segments.load
        lag = int(np.floor(late[0])) + np.rint(late - late[0]).astype(int)
        lag = lag[:1] if (lag == lag[0]).all() else lag
        part, length = float(late[0] - np.floor(late[0])), segments.y.shape[1]
        shares = np.array([part, 1 - part]) * segments.dt[:, None]
        counts = np.ceil(shares.max(axis=0) / self.model.longest_step - 1e-9).astype(int)
        spans, step = shares / np.maximum(counts, 1), _stepped(self.model, (int(counts[0]), int(counts[1])))
        spans = spans[0] if (spans == spans[0]).all() else spans
        first, then = segments.applied(lag + 1, length - 1), segments.applied(lag, length - 1)
        states = np.empty((length, *starts.shape))
        states[0] = starts
        for k in range(length - 1):
            states[k + 1] = step(states[k], first[:, :, k], then[:, :, k], body, spans)
        out = states[..., :3]
        if segments.y.shape[-1] > 3:
            out = np.concatenate([out, states[..., 3:] @ self.model.A.T], axis=-1)
        return np.moveaxis(out, 0, 2)

    def responses(self, segments: Segments, p: Array, starts: Array) -> Array:
        """Return the sensors' responses to inputs that are held for the first step, shape (r, L, m).

        Of a robot at rest without dry friction; of all headings and inputs, the few that have most of it.
        """
        (phi, late), resting = self.values(p), starts.copy()
        resting[:, 3:], phi[self.model.dry], phi[self.model.offsets] = 0.0, 0.0, 0.0
        still, found = Search(self.model, phi, self.basis[:, :0], float(late)), []
        column = segments.lead - int(np.floor(late))
        for unit in np.diag(segments.sizes):
            held = np.zeros((*segments.at.shape, segments.inputs.shape[1]))
            held[:, column] = unit
            at = np.arange(held[..., 0].size).reshape(segments.at.shape)
            there = segments._replace(inputs=held.reshape(-1, held.shape[-1]), at=at)
            out = still.simulate(there, np.zeros((1, 0)), resting[None])[0] / segments.noise[:, None]
            found.append(out - out[:, :1])
        _, sizes, rows = np.linalg.svd(np.moveaxis(np.concatenate(found), -1, 0), full_matrices=False)
        sizes = np.where(sizes > _LEAST_RESPONSE * sizes[:, :1], sizes, 0.0)
        return np.asarray(np.moveaxis((sizes[..., None] * rows)[:, :_RESPONSES], 0, -1))


def _inertia_left(phi: Array) -> float:
    """Return by how much the inertia about the centre of mass is above that of a least body."""
    m, mx, my, inertia = phi[:4]
    return float(inertia - _GYRATION**2 * m - (mx * mx + my * my) / max(m, _LIGHTEST))


def _dot(row: Array, values: Sequence[Any]) -> Any:
    """Return the sum of products with known numbers, those that are zero left out."""
    parts = [
        value if factor == 1 else float(factor) * value
        for factor, value in zip(row, values, strict=True)
        if factor
    ]
    return sum(parts[1:], parts[0]) if parts else 0.0


def _body(old: Body, mass: float, com: tuple[float, float], yaw_inertia: float) -> Body:
    """Return a body with another mass, centre of mass and yaw inertia; all else stays where it can."""
    centre = np.array([*com, old.com[2]])
    inertia = np.array(old.inertia)
    inertia[2, 2] = yaw_inertia
    try:
        return Body(mass, centre, inertia)
    except InvalidArgument:  # moments that break the triangle inequality: those of a body of the same form
        return Body(mass, centre, np.array(old.inertia) * (yaw_inertia / old.inertia[2, 2]))
