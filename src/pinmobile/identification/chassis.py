"""`Chassis`: a robot in the plane as its log sees it, linear in what is identified.

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
from dataclasses import dataclass, fields
from functools import cached_property, partial
from typing import Any, NamedTuple

import numpy as np

from pinmobile.arrays import Array, frozen
from pinmobile.compiled import vectorize
from pinmobile.errors import InvalidArgument, shown
from pinmobile.wheels import Motor, MotorLaw

_CONSTANTS = "resistance", "torque_constant", "viscous", "coulomb", "efficiency"
_STILL = 2e-3  # [rad/s], where losses of a motor have 71 % of their size; those of real ones are sharp
_STEP, _RUBBING_STEP = 5e-3, 1e-3  # [s], longest of an integration: friction changes its sign within some
_GYRATION = 0.01  # [m], least radius of a body
_LIGHTEST = 0.02  # [kg]
_NOTHING = 1e-14  # of the largest variance
_ROUNDED = 1e-6  # of what a bound lacks
_CUTS = 100  # tangents, of which some ten are needed
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
class Chassis:
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

    def __reduce__(self) -> tuple[Any, ...]:
        return Chassis, tuple(getattr(self, each.name) for each in fields(self))

    @classmethod
    def pushed(cls, speed: float, scaled: bool = False) -> Chassis:
        """Return the body that is pushed by forces."""
        eye, nothing = frozen(np.eye(3)), frozen(np.zeros((3, 3)))
        return cls(eye, eye, None, nothing, speed, scaled=scaled)

    @classmethod
    def rolling(cls, robot: Any, speed: float, scaled: bool = False) -> Chassis:
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
        A = columns.T @ turning
        volts = any(each.unit == "V" for each in robot.inputs)
        motors = tuple(each.motor for each in table.actuators) if volts else ()
        others = [each.name for each in table.actuators if volts and not each.motor.is_electric]
        if scaled and others:
            raise InvalidArgument(
                f"robot takes volts, and a torque at {', '.join(others)}, which have no scale in common that "
                "loads could tell: expected volts alone, or no loads"
            )
        S, A, B, inertia = (frozen(each) for each in (S, A, reduced.B, inertia))
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
        scale, rolls = "as a share of what is stated", bool(self.wheels)
        what = "force per input" if not rolls else "torque constants" if self.motors else "torque per input"
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
            found.append(Quantity("input_scale", "", f"{what}, {scale}", True))
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
    def bounded(self) -> list[int]:
        """Where phi has friction or a scale, which cannot be below zero."""
        return [k for k, one in enumerate(self.quantities) if one.bounded and k > 3]

    @property
    def offsets(self) -> slice:
        """Where phi has offsets of the inputs."""
        return slice(self.dry.stop, self.size - self.scaled)

    @property
    def longest_step(self) -> float:
        """Longest step with which motions are to be integrated [s]."""
        rubs = any(each.coulomb or each.efficiency < 1 for each in self.motors)
        return _RUBBING_STEP if rubs else _STEP

    def told(self, phi: Array) -> Array:
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

    def is_possible(self, phi: Array) -> bool:
        """Return whether mass and yaw inertia about the centre of mass are above zero."""
        m, mx, my, inertia = phi[:4]
        return bool(m > 0 and m * inertia > mx * mx + my * my)

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
        bounded = self.bounded

        def slack(p: Array) -> Array:
            return np.concatenate([[p[0] - _LIGHTEST, _inertia_left(p)], p[bounded]])

        if (slack(phi) >= 0).all():
            return phi
        values, vectors = np.linalg.eigh(covariance)
        told = values > _NOTHING * values.max()
        root = vectors[:, told] * np.sqrt(values[told])
        size = np.abs(slack(phi)) + 1e-3 * np.abs(phi).max()
        # Bounds, and tangents of the inequality of the body where a step is beyond it: both are convex.
        G = np.vstack([root[:1], root[bounded]])
        h = np.concatenate([[_LIGHTEST], 0 * phi[bounded]]) - np.append(phi[0], phi[bounded])
        for _ in range(_CUTS):
            z = _least(G, h)
            if z is None:
                break
            body = phi + root @ z
            if (slack(body) >= -_ROUNDED * size).all():
                body[3] += max(0.0, -_inertia_left(body))
                body[bounded] = np.maximum(body[bounded], 0.0)
                return np.asarray(body)
            m, mx, my = body[:3]
            tangent = np.array([(mx * mx + my * my) / m**2 - _GYRATION**2, -2 * mx / m, -2 * my / m, 1.0])
            G = np.vstack([G, tangent @ root[:4]])
            h = np.append(h, G[-1] @ z - _inertia_left(body))
        raise InvalidArgument(
            f"log leads to a mass of {phi[0]:.3g} kg and a yaw inertia of {self.told(phi)[3]:.3g} kg "
            "m^2, of which there is no body near: expected a log that tells them to be above zero"
        )

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
        return _solved(M, right)

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
        state = [z[i] for i in range(3 + self.free)]
        for u, span, count in zip((first, then), (spans[0], spans[1]), steps, strict=True):
            for _ in range(count):
                state = self._runge_kutta(state, u, phi, span)
        return np.stack(state)

    def _runge_kutta(self, state: Sequence[Any], u: Any, phi: Any, h: Any) -> list[Any]:
        k1 = self._rate(state, u, phi)
        k2 = self._rate([x + h / 2 * k for x, k in zip(state, k1, strict=True)], u, phi)
        k3 = self._rate([x + h / 2 * k for x, k in zip(state, k2, strict=True)], u, phi)
        k4 = self._rate([x + h * k for x, k in zip(state, k3, strict=True)], u, phi)
        each = zip(state, k1, k2, k3, k4, strict=True)
        return [x + h / 6 * (a + 2 * (b + c) + d) for x, a, b, c, d in each]

    def _rate(self, state: Sequence[Any], u: Any, phi: Any) -> list[Any]:
        psi, eta = state[2], state[3:]
        forward, left, r = (_dot(row, eta) for row in self.S)
        c, s = np.cos(psi), np.sin(psi)
        return [c * forward - s * left, s * forward + c * left, r, *self.acceleration(psi, eta, u, phi)]

    def stepped(self, steps: tuple[int, int]) -> Callable[..., Array]:
        """Return `step` of many states, compiled."""
        if steps not in self._compiled:
            self._compiled[steps] = vectorize(partial(self.step, steps=steps), checked=False)
        return self._compiled[steps]

    @cached_property
    def _compiled(self) -> dict[tuple[int, int], Callable[..., Array]]:
        return {}


def _inertia_left(phi: Array) -> float:
    """Return by how much the inertia about the centre of mass is above that of a least body."""
    m, mx, my, inertia = phi[:4]
    return float(inertia - _GYRATION**2 * m - (mx * mx + my * my) / max(m, _LIGHTEST))


def _least(G: Array, h: Array) -> Array | None:
    """Return the shortest z with G z >= h, or None where there is none (Lawson and Hanson, 1974, 23.4)."""
    from scipy.optimize import nnls  # here, because it takes long to load

    length = np.linalg.norm(G, axis=1)
    if (h[length == 0] > 0).any():
        return None
    told = length > 0
    G, h = G[told] / length[told, None], h[told] / length[told]
    far = max(float(np.abs(h).max(initial=0.0)), 1e-300)
    E, f = np.vstack([G.T, h / far]), np.append(np.zeros(G.shape[1]), 1.0)
    rest = E @ nnls(E, f)[0] - f
    return None if rest[-1] > -_NOTHING else np.asarray(-rest[:-1] / rest[-1] * far)


def _dot(row: Array, values: Sequence[Any]) -> Any:
    """Return the sum of products with known numbers, those that are zero left out."""
    total: Any = None
    for factor, value in zip(row, values, strict=True):
        if factor:
            part = value if factor == 1 else float(factor) * value
            total = part if total is None else total + part
    return 0.0 if total is None else total


def _solved(M: Sequence[Sequence[Any]], b: Sequence[Any]) -> list[Any]:
    """Return the solution of a small system by elimination; its matrix is positive definite."""
    M, b, n = [list(row) for row in M], list(b), len(b)
    for i in range(n):
        for j in range(i + 1, n):
            factor = M[j][i] / M[i][i]
            M[j] = [a - factor * c for a, c in zip(M[j], M[i], strict=True)]
            b[j] = b[j] - factor * b[i]
    x: list[Any] = [0.0] * n
    for i in reversed(range(n)):
        rest = b[i]
        for j in range(i + 1, n):
            rest = rest - M[i][j] * x[j]
        x[i] = rest / M[i][i]
    return x
