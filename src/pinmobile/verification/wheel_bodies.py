"""A robot on wheels as its bodies: the body, arms and each wheel by Newton's and Euler's laws, one by one.

Nothing of Pinocchio's tree, of the rows of the wheel table or of its energies is read: where a wheel is, how
it turns and what moves it is written out here from the table's numbers alone.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pinmobile.arrays import Array
from pinmobile.robot import BODY_JOINT
from pinmobile.verification.bodies import Parts
from pinmobile.wheels import Ackermann, GearTrain, Wheel, WheeledRobot


class _Moving(NamedTuple):
    """A wheel at n states, all along the body's axes.

    Attributes
    ----------
    e, n : ndarray, shape (k, 2)
        Where it rolls to, and its axle.
    o, p : ndarray, shape (k, 2)
        Its centre from its pivot, and from the body's origin [m].
    axis : int
        Its steering coordinate; -1: none.
    first, turn, changing : ndarray, shape (k,)
        Its steering angle's rate per rate of that coordinate, its rate, and the part of the rate's derivative
        that is there where the coordinate does not accelerate.
    """

    e: Array
    n: Array
    o: Array
    p: Array
    axis: int
    first: Array
    turn: Array
    changing: Array


class WheelBodies:
    """The bodies of a robot on wheels at n states.

    Parameters
    ----------
    wheeled : WheeledRobot
        Whose `robot`, `table` and `ground` are read.
    q, v : ndarray, shape (n, nq) and (n, nv)
        States.
    weightless : bool
        Whether there is no gravity.
    """

    def __init__(self, wheeled: WheeledRobot, q: Array, v: Array, *, weightless: bool = False) -> None:
        robot, self.table = wheeled.robot, wheeled.table
        nv, self.ns = robot.nv, len(wheeled.table.axes)
        g = float(np.linalg.norm(robot.model.gravity.linear))
        ramp = wheeled.ground.ramp
        fall = np.array([0.0, 0.0, -g]) if ramp is None else ramp.fall(g)
        self.fall = 0.0 * fall if weightless else fall
        self.parts = Parts(robot, q[:, :nv], v[:, :nv], self.fall)
        self.beyond = self.parts.beyond()
        self.c, self.s, self.nv = np.cos(q[:, 2]), np.sin(q[:, 2]), nv
        self.twist = np.column_stack([self._along(v), v[:, 2]])
        self.rates = v[:, nv:]
        self.wheels = [self._moving(row, q[:, nv : nv + self.ns]) for row in range(len(self.table))]
        self.reflected = np.zeros((self.rates.shape[1], self.rates.shape[1]))
        for actuator in self.table.actuators:
            column, rotor = np.array(actuator.column), actuator.motor.gear**2 * actuator.motor.rotor_inertia
            self.reflected += rotor * np.outer(column, column)
        for (
            wheel
        ) in self.table.wheels:  # the whole has them, at rest in the body: they are bodies of their own
            lever, inertia = np.array([*wheel.centre, wheel.radius]), _locked(wheel)
            self.parts.links[BODY_JOINT - 1].bodies.append((-wheel.mass, lever, -inertia))

    def _along(self, x: Array) -> Array:
        """Return the first two entries of each row along the body's axes."""
        return np.column_stack([self.c * x[:, 0] + self.s * x[:, 1], self.c * x[:, 1] - self.s * x[:, 0]])

    def _inertial(self, x: Array) -> Array:
        return np.column_stack([self.c * x[:, 0] - self.s * x[:, 1], self.s * x[:, 0] + self.c * x[:, 1]])

    def _moving(self, row: int, steering: Array) -> _Moving:
        wheel = self.table.wheels[row]
        axis = next((k for k, each in enumerate(self.table.axes) if row in each.wheels), -1)
        still = np.zeros(len(steering))
        angle, first, second, rate = still, still, still, still
        if axis >= 0:
            angle, first, rate = steering[:, axis], still + 1, self.rates[:, axis]
        for each in self.table.couplings:
            if isinstance(each, Ackermann) and wheel.name in each.wheels:
                # cot(angle) = cot(coordinate) - k, whose squared sines have `first` as ratio.
                k, c, s = wheel.y / (wheel.x - each.axle), np.cos(angle), np.sin(angle)
                first = 1 / (s**2 + (c - k * s) ** 2)
                second = -2 * (s * c - (c - k * s) * (s + k * c)) * first**2
                angle = np.arctan2(s, c - k * s)
        angle = angle + wheel.angle
        e = np.column_stack([np.cos(angle), np.sin(angle)])
        n = _quarter(e)
        o = wheel.trail[0] * e + wheel.trail[1] * n
        return _Moving(e, n, o, o + np.array([wheel.x, wheel.y]), axis, first, first * rate, second * rate**2)

    def _wrenches(self, a: Array) -> list[tuple[Array, Array]]:
        """Return for each wheel the force (k, 3) that moves it, and the moment (k, 3) about its centre."""
        found = []
        origin, pull = self._along(a), self._along(np.broadcast_to(self.fall, (len(a), 3)))
        w, alpha = self.twist[:, 2:], a[:, 2:3]
        for row, (wheel, at) in enumerate(zip(self.table.wheels, self.wheels, strict=True)):
            turning = alpha[:, 0] + at.changing
            if at.axis >= 0:
                turning = turning + at.first * a[:, self.nv + at.axis]
            whole = w + at.turn[:, None]
            pivot = at.p - at.o
            moved = origin + alpha * _quarter(pivot) - w**2 * pivot
            moved = moved + turning[:, None] * _quarter(at.o) - whole**2 * at.o
            force = np.column_stack(
                [wheel.mass * (moved - pull), np.full(len(a), -wheel.mass * self.fall[2])]
            )
            spin, faster = self.rates[:, self.ns + row, None], a[:, self.nv + self.ns + row, None]
            flat = wheel.spin_inertia * (faster * at.n - spin * whole * at.e)
            found.append((force, np.column_stack([flat, wheel.yaw_inertia * turning])))
        return found

    def wrench(self, a: Array) -> Array:
        """Return what moves the whole, along the body's axes and about its origin, shape (n, 6)."""
        total = self.parts.ground_wrench(a[:, : self.nv])
        for wheel, at, (force, moment) in zip(self.table.wheels, self.wheels, self._wrenches(a), strict=True):
            arm = np.column_stack([at.p, np.full(len(a), wheel.radius)])
            total = total + np.hstack([force, moment + np.cross(arm, force)])
        return total

    def forces(self, a: Array) -> Array:
        """Return the generalised forces that these accelerations ask for, shape (n, nv of the whole)."""
        tau = np.zeros_like(a)
        tau[:, : self.nv] = self.parts.forces(a[:, : self.nv])
        total = self.wrench(a)
        tau[:, :2], tau[:, 2] = self._inertial(total), total[:, 5]
        tau[:, self.nv :] = a[:, self.nv :] @ self.reflected
        for row, (at, (force, moment)) in enumerate(zip(self.wheels, self._wrenches(a), strict=True)):
            if at.axis >= 0:
                about = moment[:, 2] + _crossed(at.o, force)
                tau[:, self.nv + at.axis] += at.first * about
            tau[:, self.nv + self.ns + row] += np.einsum("ni,ni->n", moment[:, :2], at.n)
        return tau

    def contact(self, along: Array, across: Array) -> Array:
        """Return the generalised force of the ground's forces on the wheels, shape (n, nv of the whole).

        Parameters
        ----------
        along, across : ndarray, shape (n, wheels)
            Of a tyre along it and to its left; of a wheel with rollers along the axis of the one at
            the ground, and across that [N].
        """
        tau = np.zeros((len(along), self.nv + self.rates.shape[1]))
        for row, at in enumerate(self.wheels):
            gamma = self.table.wheels[row].roller or 0.0
            d = np.cos(gamma) * at.e + np.sin(gamma) * at.n
            force = along[:, row, None] * d + across[:, row, None] * _quarter(d)
            tau[:, :2] += self._inertial(force)
            tau[:, 2] += _crossed(at.p, force)
            if at.axis >= 0:
                tau[:, self.nv + at.axis] += at.first * _crossed(at.o, force)
            spun = self.table.wheels[row].radius * np.einsum("ni,ni->n", force, at.e)
            tau[:, self.nv + self.ns + row] -= spun
        return tau

    def trains(self) -> Array:
        """Return the rows of gear trains, r (ratio phi_1' - phi_k'), shape (pairs, nv of the whole)."""
        names, rows = self.table.names, []
        for train in self.table.couplings:
            if isinstance(train, GearTrain):
                first = names.index(train.wheels[0])
                radius = self.table.wheels[first].radius
                for name, ratio in zip(train.wheels[1:], train.ratios[1:], strict=True):
                    row = np.zeros(self.nv + self.rates.shape[1])
                    row[self.nv + self.ns + first] = radius * ratio / train.ratios[0]
                    row[self.nv + self.ns + names.index(name)] = -radius
                    rows.append(row)
        return np.reshape(rows, (len(rows), self.nv + self.rates.shape[1]))

    def moving(self) -> tuple[Array, Array, Array]:
        """Return what each coordinate moves: mass (nv,), second moment (n, nv), and the reach (n,) [m]."""
        masses, K, reach = self.beyond
        first = self.nv + self.ns
        masses = np.append(masses, np.zeros(self.rates.shape[1]))
        K = np.hstack([K, np.zeros((len(K), self.rates.shape[1]))])
        for row, (wheel, at) in enumerate(zip(self.table.wheels, self.wheels, strict=True)):
            if at.axis >= 0:
                k = self.nv + at.axis
                masses[k] += wheel.mass
                K[:, k] += at.first**2 * (
                    wheel.yaw_inertia + wheel.mass * np.square(np.array(wheel.trail)).sum()
                )
            own = wheel.spin_inertia + self.reflected[self.ns + row, self.ns + row]
            masses[first + row] = wheel.mass + own / wheel.radius**2
            K[:, first + row] = own
        return masses, K, reach


def _locked(wheel: Wheel) -> Array:
    """Return the inertia of a wheel about its centre at the table's angle, along the body's axes."""
    c, s = np.cos(wheel.angle), np.sin(wheel.angle)
    R = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    return np.asarray(R @ np.diag([wheel.yaw_inertia, wheel.spin_inertia, wheel.yaw_inertia]) @ R.T)


def _quarter(x: Array) -> Array:
    """Return z x x: a quarter of a turn to the left."""
    return np.stack([-x[..., 1], x[..., 0]], axis=-1)


def _crossed(p: Array, force: Array) -> Array:
    """Return the moment of a force at p about the vertical."""
    return np.asarray(p[:, 0] * force[:, 1] - p[:, 1] * force[:, 0])
