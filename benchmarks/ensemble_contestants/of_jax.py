"""JAX on the CPU in double precision: `vmap` of `scan`, compiled before it is timed."""

import os
from collections.abc import Sequence

import numpy as np
from fleet import GAIN, NOMINAL, Figures, Fleet, Run, on_circle

os.environ.setdefault("JAX_PLATFORMS", "cpu")
import jax
import jax.numpy as jnp

jax.config.update("jax_enable_x64", True)
Three = tuple[jax.Array, jax.Array, jax.Array]


def rollout(fleet: Fleet) -> Run:
    mass, com, given = fleet.mass, fleet.com, fleet.references()

    def robot(mass: jax.Array, com: jax.Array, given: jax.Array) -> tuple[Three, Three, Three, jax.Array]:
        def sample(carried: tuple, at: jax.Array) -> tuple[tuple, None]:
            q, v, (errors, squares, forces, farthest) = carried
            e, force, a = dynamics(mass, com, at, q, v)
            seen = largest(errors, e), added(squares, e), largest(forces, force)
            farther = jnp.maximum(farthest, e[0] ** 2 + e[1] ** 2)
            dt = fleet.task.dt
            q = tuple(x + dt * u + dt**2 / 2 * b for x, u, b in zip(q, v, a, strict=True))
            v = tuple(u + dt * b for u, b in zip(v, a, strict=True))
            return (q, v, (*seen, farther)), None

        zero = (jnp.float64(0),) * 3
        start = tuple(given[0, :3]), tuple(given[0, 3:6]), (zero, zero, zero, zero[0])
        return jax.lax.scan(sample, start, given)[0][2]

    batch = jax.jit(jax.vmap(robot, in_axes=(0, 0, None))).lower(mass, com, given).compile()

    def run() -> Figures:
        errors, squares, forces, farthest = jax.block_until_ready(batch(mass, com, fleet.references()))
        rms = np.sqrt(np.column_stack(squares) / fleet.task.samples)
        return Figures(np.column_stack(errors), rms, np.column_stack(forces), np.sqrt(farthest))

    return run


def dynamics(
    mass: jax.Array, com: jax.Array, at: jax.Array, q: Three, v: Three
) -> tuple[Three, Three, Three]:
    """Return error, force and acceleration."""
    m, (lever, _), inertia = NOMINAL.mass, NOMINAL.com, NOMINAL.yaw_inertia
    s, c, rr = jnp.sin(q[2]), jnp.cos(q[2]), v[2] ** 2
    ex, ey, ep = at[0] - q[0], at[1] - q[1], on_circle(at[2] - q[2], jnp)
    ax, ay, ar = (at[6 + i] + GAIN * (at[3 + i] - v[i] + e) for i, e in enumerate((ex, ey, ep)))
    dx, dy = lever * c, lever * s
    fx, fy = m * (ax - dy * ar - rr * dx), m * (ay + dx * ar - rr * dy)
    mz = m * (dx * ay - dy * ax) + (m * lever**2 + inertia) * ar
    dx, dy = com * c, com * s
    br = (mz + dy * fx - dx * fy) / inertia
    bx, by = fx / mass + rr * dx + dy * br, fy / mass + rr * dy - dx * br
    return (ex, ey, ep), (fx, fy, mz), (bx, by, br)


def largest(before: Sequence[jax.Array], values: Sequence[jax.Array]) -> Three:
    return tuple(jnp.maximum(one, jnp.abs(other)) for one, other in zip(before, values, strict=True))


def added(before: Sequence[jax.Array], values: Sequence[jax.Array]) -> Three:
    return tuple(one + other**2 for one, other in zip(before, values, strict=True))
