"""The closed form in numpy, all robots at once: arrays written in place, and as most write it."""

from math import tau

import numpy as np
from fleet import BINS, EVERY, GAIN, NOMINAL, Figures, Fleet, Run, Watch, command, counted

BLOCK = 4096  # robots that go through time together: their arrays stay in the second cache


def arrays(fleet: Fleet) -> Run:
    """Make the arrays first; blocks of robots take turns in them."""
    blocks = [slice(k, min(k + BLOCK, fleet.n)) for k in range(0, fleet.n, BLOCK)]
    rooms = {size: Room(size) for size in {part.stop - part.start for part in blocks}}
    mass, com, samples = fleet.mass, fleet.com, fleet.task.samples

    def run() -> Figures:
        given = fleet.references().tolist()
        largest, rms, force = np.empty((3, 3, fleet.n))
        farthest, counts = np.empty(fleet.n), np.zeros((2, fleet.kept, BINS), np.int32)
        for part in blocks:
            room = rooms[part.stop - part.start]
            room.roll(given, mass[part], com[part], fleet.task.dt, counts)
            largest[:, part], force[:, part] = room.largest, room.strongest
            np.sqrt(room.squares / samples, out=rms[:, part])
            np.sqrt(room.farthest, out=farthest[part])
        return Figures(largest.T, rms.T, force.T, farthest, counts)

    return run


class Room:
    """The arrays of a block: (3, n) what has coordinates, and scratch."""

    def __init__(self, n: int) -> None:
        self.q, self.v, self.a, self.e, self.f = np.empty((5, 3, n))
        self.largest, self.strongest, self.squares, self.scratch = np.empty((4, 3, n))
        self.farthest, self.s, self.c, self.dx, self.dy, self.rr, self.one, self.other = np.empty((8, n))

    def roll(
        self, given: list[list[float]], mass: np.ndarray, com: np.ndarray, dt: float, counts: np.ndarray
    ):
        """Go through time from the first reference."""
        for array in (self.largest, self.strongest, self.squares, self.farthest):
            array[:] = 0.0
        self.q.T[:], self.v.T[:] = given[0][:3], given[0][3:6]
        lighter, half = 1 / mass, dt * dt / 2
        for k, at in enumerate(given):
            self.control(at)
            self.watch()
            if k % EVERY == 0:
                counts[0, k // EVERY] += counted(np.sqrt(self.other, out=self.other))
                counts[1, k // EVERY] += counted(np.abs(self.e[2], out=self.one))
            self.plant(lighter, com)
            for change, scale in ((self.v, dt), (self.a, half)):
                self.q += np.multiply(change, scale, out=self.scratch)
            self.v += np.multiply(self.a, dt, out=self.scratch)

    def control(self, at: list[float]) -> None:
        """Set error and force."""
        e, f, a, one = self.e, self.f, self.a, self.one
        m, (lever, _) = NOMINAL.mass, NOMINAL.com
        for i in range(3):
            np.subtract(at[i], self.q[i], out=e[i])
            np.subtract(at[3 + i], self.v[i], out=a[i])
        np.rint(np.multiply(e[2], 1 / tau, out=one), out=one)
        e[2] -= np.multiply(one, tau, out=one)
        a += e
        a *= GAIN
        for i in range(3):
            a[i] += at[6 + i]
        np.sin(self.q[2], out=self.s), np.cos(self.q[2], out=self.c)
        dx, dy = np.multiply(self.c, m * lever, out=self.dx), np.multiply(self.s, m * lever, out=self.dy)
        np.multiply(a[2], m * lever**2 + NOMINAL.yaw_inertia, out=f[2])
        f[2] += np.multiply(dx, a[1], out=one)
        f[2] -= np.multiply(dy, a[0], out=one)
        rr = np.square(self.v[2], out=self.rr)
        a[:2] *= m
        for i, across, along, turn in ((0, dy, dx, np.subtract), (1, dx, dy, np.add)):
            turn(a[i], np.multiply(across, a[2], out=one), out=f[i])
            f[i] -= np.multiply(along, rr, out=one)

    def plant(self, lighter: np.ndarray, com: np.ndarray) -> None:
        """Set the acceleration."""
        a, f, one = self.a, self.f, self.one
        dx, dy = np.multiply(com, self.c, out=self.dx), np.multiply(com, self.s, out=self.dy)
        np.multiply(dy, f[0], out=a[2])
        a[2] -= np.multiply(dx, f[1], out=one)
        a[2] += f[2]
        a[2] *= 1 / NOMINAL.yaw_inertia
        for i, across, along, turn in ((0, dy, dx, np.add), (1, dx, dy, np.subtract)):
            np.multiply(f[i], lighter, out=a[i])
            a[i] += np.multiply(self.rr, along, out=one)
            turn(a[i], np.multiply(across, a[2], out=one), out=a[i])

    def watch(self) -> None:
        """Take in the sample; leave the squared distance in `other`."""
        scratch = self.scratch
        np.maximum(self.largest, np.abs(self.e, out=scratch), out=self.largest)
        np.maximum(self.strongest, np.abs(self.f, out=scratch), out=self.strongest)
        self.squares += np.square(self.e, out=scratch)
        np.add(scratch[0], scratch[1], out=self.other)
        np.maximum(self.farthest, self.other, out=self.farthest)


def solved(fleet: Fleet) -> Run:
    """M and n as most write them, and np.linalg.solve."""
    mass, com, dt = fleet.mass, fleet.com, fleet.task.dt
    known_mass, known_com = np.full(fleet.n, NOMINAL.mass), np.full(fleet.n, NOMINAL.com[0])

    def run() -> Figures:
        given, watch = fleet.references(), Watch(fleet)
        q, v = np.tile(given[0, :3], (fleet.n, 1)), np.tile(given[0, 3:6], (fleet.n, 1))
        for k, at in enumerate(given):
            error, wanted = command(at, q, v)
            M, bias = dynamics(known_mass, known_com, q, v)
            force = (M @ wanted[..., None])[..., 0] + bias
            watch.see(k, error, force)
            M, bias = dynamics(mass, com, q, v)
            a = np.linalg.solve(M, (force - bias)[..., None])[..., 0]
            q = q + dt * v + dt**2 / 2 * a
            v = v + dt * a
        return watch.figures()

    return run


def dynamics(
    mass: np.ndarray, com: np.ndarray, q: np.ndarray, v: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return M, (n, 3, 3), and n, (n, 3)."""
    mx, my = mass * com * np.cos(q[:, 2]), mass * com * np.sin(q[:, 2])
    M, rr = np.zeros((len(q), 3, 3)), v[:, 2] ** 2
    M[:, 0, 0] = M[:, 1, 1] = mass
    M[:, 0, 2] = M[:, 2, 0] = -my
    M[:, 1, 2] = M[:, 2, 1] = mx
    M[:, 2, 2] = mass * com**2 + NOMINAL.yaw_inertia
    return M, np.column_stack([-rr * mx, -rr * my, np.zeros_like(rr)])
