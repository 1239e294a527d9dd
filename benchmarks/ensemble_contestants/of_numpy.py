"""The closed form in numpy, all robots at once, as most write it."""

import numpy as np
from fleet import NOMINAL, Figures, Fleet, Run, Watch, command


def rollout(fleet: Fleet) -> Run:
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
