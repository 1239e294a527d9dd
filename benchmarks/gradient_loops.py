"""The loops of `derivatives.py`, and the same in JAX and in CasADi: reverse mode, in double precision.

In theirs, the arm's mass matrix and bias serve both controller and plant, which know the same arm.
"""

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any, ClassVar

import numpy as np
from contestants import Peer
from ensemble_contestants import JAX

import pinmobile as pm
from pinmobile.derivatives import _problem
from pinmobile.derivatives._gradient import Loss, Losses

CASADI = Peer("casadi", "casadi", "pip install casadi")
PEERS = {"JAX": JAX, "CasADi": CASADI}
AXES = ("PX", "PY", "PZ", "RX", "RY", "RZ")  # of joints, in the order of a spatial velocity
Run = Callable[[], Any]
OFF = (0.1, -0.1, 0.2)
BODY, CIRCLE = pm.MobileRobot(30.0, 1.3, com=(0.1, 0.05)), pm.Tangent(pm.Circle(1.0, 0.8, 2.0))
ARM = pm.MobileRobot.box(60, (0.8, 0.6, 0.3)).mount("ur5", (0.2, 0, 0.3, 0))


def loss(sample: Any) -> Any:
    return (sample.error**2).sum() + 1e-6 * (sample.u**2).sum()


@dataclass(frozen=True, eq=False)
class Policy:
    """Two layers of 16 and one of 3 forces, beside a PD."""

    w1: Any
    w2: Any
    w3: Any
    parameters: ClassVar = ("w1", "w2", "w3")

    def initial_state(self, context: Any) -> Any:
        """Return the difference of configurations."""
        return {"difference": context.difference}

    def __call__(self, t: Any, q: Any, v: Any, reference: Any, state: Any) -> Any:
        """Return the forces."""
        e, de, one = state["difference"](q, reference.q), reference.v - v, np.ones(1)
        h = np.concatenate([e, de, np.array([np.sin(q[2]), np.cos(q[2]), 1.0])])
        for w in (self.w1, self.w2):
            h = np.concatenate([np.tanh(w @ h), one])
        return 120 * e + 80 * de + 10 * (self.w3 @ h), state


@dataclass
class Case:
    """A loop, the numbers by which its loss is differentiated, and the law of the peers."""

    name: str
    parts: tuple[Any, Any, Any]
    by: Sequence[str]
    law: str = ""
    q0: Any = None
    dt: float = 0.001
    own: dict[str, Any] = field(default_factory=dict)
    modes: tuple[str, ...] = ("forward", "reverse")

    def problem(self, **own: Any) -> Any:
        """Return the problem."""
        given = {"dt": self.dt, "n": 1, **self.own, **own}
        start = self.q0, None
        return _problem.problem_of(
            *self.parts, lambda scenario: Losses((Loss.read(loss, None, scenario),)), self.by, start, **given
        )


def cases() -> dict[str, Case]:
    random = np.random.default_rng(0).standard_normal
    layers = [0.3 * random((m, n)) for m, n in ((16, 9), (16, 17), (3, 17))]
    off, gains, rk4 = 0.01 * random((2, 3, 3)), ("controller.kp", "controller.kd"), {"integrator": pm.rk4}
    full = pm.PD(np.diag([120.0, 120, 60]) + off[0], np.diag([80.0, 80, 30]) + off[1])
    motion = pm.WholeBody(ARM, CIRCLE, pm.Spline([[0.0] * 6, [-0.5] * 6], [0, 2]))
    q0 = motion(0.0).q + np.append([0.05, -0.05, 0.1], np.full(6, 0.02))
    arm = ARM, pm.ComputedTorque(ARM, np.full(9, 100.0), np.full(9, 20.0)), motion
    wheels = pm.WheelTable.differential(0.5, 0.1, supports=[(-0.3, 0)], mass=1.0, spin_inertia=0.005)
    body, path = pm.MobileRobot(30.0, 1.3, com=(0.1, 0.05, 0.2)), pm.Tangent(pm.Circle(1.0, 0.5, 2.0))
    rolling, dry = pm.WheeledRobot(body, wheels), pm.WheeledRobot(body, wheels, pm.Coulomb(mu=0.8))
    law, five = pm.Backstepping(pm.UnicycleTracking(), rolling), ("law.zeta", "law.b", "k", "steer", "arms")
    by, begun = [f"controller.{name}" for name in five], np.zeros(5)
    begun[:3] = path(0.0).q + np.array([0.1, -0.1, 0.0])
    shift = [*gains, "plant.com.x", "plant.com.y"]
    net = BODY, Policy(*layers), CIRCLE
    return {
        "PD": Case("PD: 2 gains", (BODY, pm.PD(120, 80), CIRCLE), gains, "gains", OFF, own=rk4),
        "com": Case("PD: 18 gains, com", (BODY, full, CIRCLE), shift, "matrices", OFF, own=rk4),
        "policy": Case("467 weights", net, [f"controller.w{i}" for i in (1, 2, 3)], "policy", OFF),
        "arm": Case("UR5 on a base: 18 gains", arm, gains, "arm", q0),
        "rolling": Case("rolling wheels: 5 gains", (rolling, law, path), by, "", begun, 0.005),
        "dry": Case("dry friction: 5 gains", (dry, law, path), by, "", begun, 0.005, modes=("forward",)),
    }


def planar(lib: Any, com: Any, q: Any, v: Any, u: Any) -> Any:
    """Return the acceleration of a body of 30 kg and 1.3 kg m2."""
    c, s, rr = lib.cos(q[2]), lib.sin(q[2]), v[2] ** 2
    dx, dy = com[0] * c - com[1] * s, com[0] * s + com[1] * c
    turn = (u[2] + dy * u[0] - dx * u[1]) / 1.3
    return lib.join(u[0] / 30 + rr * dx + dy * turn, u[1] / 30 + rr * dy - dx * turn, turn)


def chain(robot: Any) -> list[tuple[Any, ...]]:
    """Return coordinate, kind, constant parts of the transform, axis and inertia of each joint of a robot."""
    import pinocchio as pin

    names, model, found = [one.name for one in robot.coordinates], robot.model, []
    for i in range(1, model.njoints):
        kind = model.joints[i].shortname()[-2:]
        axis = np.eye(6)[AXES.index(kind)]
        place, cross = model.jointPlacements[i].inverse().action, pin.Motion(axis).action
        parts = place, cross @ place, cross @ cross @ place, cross, axis, model.inertias[i].matrix()
        found.append((names.index(model.names[i]), kind[0] == "R", *parts))
    return found


def inverse_dynamics(lib: Any, joints: Any, q: Any, v: Any, a: Any, gravity: float = 9.81) -> Any:
    """Return the forces of a chain of joints by the recursive Newton-Euler algorithm."""
    velocity, acceleration = lib.const(np.zeros(6)), lib.const(np.eye(6)[2] * gravity)
    passed, total, found = [], lib.const(np.zeros(6)), dict[int, Any]()
    for i, turns, *parts in joints:
        place, once, twice, cross, axis, inertia = map(lib.const, parts)
        X = place - lib.sin(q[i]) * once + (1 - lib.cos(q[i])) * twice if turns else place - q[i] * once
        velocity = X @ velocity + axis * v[i]
        acceleration = X @ acceleration + axis * a[i] - (cross @ velocity) * v[i]
        h, (line, spin) = inertia @ velocity, (velocity[:3], velocity[3:])
        turned = lib.cross(spin, h[:3]), lib.cross(spin, h[3:]) + lib.cross(line, h[:3])
        passed.append((i, X, axis, inertia @ acceleration + lib.join(*turned)))
    for i, X, axis, force in reversed(passed):
        total = total + force
        found[i] = lib.dot(axis, total)
        total = X.T @ total
    return lib.join(*(found[i] for i in range(len(found))))


def sample(lib: Any, law: str, joints: Any, dt: float, state: Any, row: Any, p: Any) -> Any:
    """Return configuration, velocity and loss after a sample."""
    n = 9 if law == "arm" else 3
    q, v = state[:n], state[n : 2 * n]
    e, de = row[1 : 1 + n] - q, row[1 + n : 1 + 2 * n] - v
    e = lib.join(e[:2], lib.arctan2(lib.sin(e[2]), lib.cos(e[2])), e[3:])
    com = (p[18], p[19]) if law == "matrices" else (0.1, 0.05)
    if law == "gains":
        u = p[0] * e + p[1] * de
    elif law == "matrices":
        u = lib.matrix(p[:9], 3, 3) @ e + lib.matrix(p[9:18], 3, 3) @ de
    elif law == "policy":
        w1, w2, w3 = (lib.matrix(p[i:j], m, -1) for i, j, m in ((0, 144, 16), (144, 416, 16), (416, 467, 3)))
        h = lib.join(lib.tanh(w1 @ lib.join(e, de, lib.sin(q[2]), lib.cos(q[2]), 1.0)), 1.0)
        u = 120 * e + 80 * de + 10 * (w3 @ lib.join(lib.tanh(w2 @ h), 1.0))
    else:
        zero = lib.const(np.zeros(n))
        M = lib.columns(lambda a: inverse_dynamics(lib, joints, q, zero, a, 0.0), n)
        bias = inverse_dynamics(lib, joints, q, v, zero)
        u = M @ (row[1 + 2 * n :] + p[n:] * de + p[:n] * e) + bias
        a = lib.solve(M, u - bias)
    loss = state[2 * n] + lib.dot(e, e) + 1e-6 * lib.dot(u, u)
    if law not in ("gains", "matrices"):
        a = a if law == "arm" else planar(lib, com, q, v, u)
        return lib.join(q + dt * v + dt**2 / 2 * a, v + dt * a, loss)
    a = planar(lib, com, q, v, u)
    b = planar(lib, com, q + dt / 2 * v, v + dt / 2 * a, u)
    c = planar(lib, com, q + dt / 2 * v + dt**2 / 4 * a, v + dt / 2 * b, u)
    d = planar(lib, com, q + dt * v + dt**2 / 2 * b, v + dt * c, u)
    return lib.join(q + dt * v + dt**2 / 6 * (a + b + c), v + dt / 6 * (a + 2 * b + 2 * c + d), loss)


def of_jax(law: str, joints: Any, dt: float, start: Any, rows: Any, p: Any) -> Callable[[], Run]:
    """Return what compiles the gradient of a `scan`."""
    os.environ.setdefault("JAX_PLATFORMS", "cpu")
    os.environ.setdefault("XLA_FLAGS", "--xla_cpu_multi_thread_eigen=false")
    import jax
    import jax.numpy as jnp

    jax.config.update("jax_enable_x64", True)
    lib = SimpleNamespace(**{name: getattr(jnp, name) for name in ("sin", "cos", "tanh", "arctan2", "dot")})
    lib.cross, lib.const, lib.join = jnp.cross, jnp.asarray, lambda *x: jnp.hstack(x)
    lib.matrix, lib.columns = lambda x, m, n: x.reshape(m, n), lambda f, n: jax.vmap(f)(jnp.eye(n))
    lib.solve = lambda M, b: jax.scipy.linalg.solve(M, b, assume_a="pos")

    def total(p: Any, start: Any, rows: Any) -> Any:
        return jax.lax.scan(lambda x, row: (sample(lib, law, joints, dt, x, row, p), None), start, rows)[0][
            -1
        ]

    given = tuple(map(jnp.asarray, (p, start, rows)))
    jax.block_until_ready(jax.jit(lambda x: x + 1.0)(1.0))  # what a process starts once

    def build() -> Run:
        made = jax.jit(jax.grad(total)).lower(*given).compile()
        return lambda: np.asarray(jax.block_until_ready(made(*given)))

    return build


def of_casadi(law: str, joints: Any, dt: float, start: Any, rows: Any, p: Any) -> Callable[[], Run]:
    """Return what makes the gradient of a `mapaccum` of a function of scalars, which CasADi interprets."""
    import casadi as ca

    lib = SimpleNamespace(**{name: getattr(ca, name) for name in ("sin", "cos", "tanh", "arctan2", "dot")})
    lib.cross, lib.const, lib.join, lib.solve = ca.cross, ca.DM, ca.vertcat, ca.solve
    lib.matrix = lambda x, m, n: ca.reshape(x, x.numel() // m, m).T
    lib.columns = lambda f, n: ca.horzcat(*(f(ca.DM(each)) for each in np.eye(n)))
    columns = rows.T.copy()

    def build() -> Run:
        x, row, own = (
            ca.SX.sym(name, len(each)) for name, each in zip("xrp", (start, columns, p), strict=True)
        )
        step = ca.Function("step", [x, row, own], [sample(lib, law, joints, dt, x, row, own)])
        given = ca.MX.sym("p", len(p))
        last = step.mapaccum("all", len(rows))(ca.DM(start), ca.DM(columns), ca.repmat(given, 1, len(rows)))
        made = ca.Function("gradient", [given], [ca.gradient(last[-1, -1], given)])
        return lambda: np.asarray(made(p)).ravel()

    return build


MAKERS = {"JAX": of_jax, "CasADi": of_casadi}
