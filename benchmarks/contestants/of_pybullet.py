"""PyBullet: M and inverse dynamics are the engine's; it has no forward dynamics, so M is solved here."""

import tempfile
from collections.abc import Callable
from math import remainder, tau
from pathlib import Path
from typing import Any

import numpy as np
import pybullet
from task import GAIN, Body, Log, Run, Task, chunks, references, split

LINK = '<link name="{name}"><inertial><origin xyz="{x} {y} 0"/><mass value="{mass}"/><inertia \
ixx="{inertia}" iyy="{inertia}" izz="{inertia}" ixy="0" ixz="0" iyz="0"/></inertial></link>'
JOINT = '<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>\
<axis xyz="{axis}"/><limit lower="-1e9" upper="1e9" effort="1e9" velocity="1e9"/></joint>'


def urdf(body: Body) -> str:
    """Return the planar chain: ground, two links without mass, the body."""
    x, y = body.com
    links = [LINK.format(name=name, x=0, y=0, mass=0, inertia=0) for name in ("ground", "along_x", "along_y")]
    links.append(LINK.format(name="body", x=x, y=y, mass=body.mass, inertia=body.yaw_inertia))
    joints = [
        JOINT.format(name="x", kind="prismatic", parent="ground", child="along_x", axis="1 0 0"),
        JOINT.format(name="y", kind="prismatic", parent="along_x", child="along_y", axis="0 1 0"),
        JOINT.format(name="psi", kind="continuous", parent="along_y", child="body", axis="0 0 1"),
    ]
    return f'<robot name="planar">{"".join(links + joints)}</robot>'


def build(body: Body) -> tuple[int, int]:
    """Return the robot and the simulation it is in; Bullet reads models from files only."""
    client = pybullet.connect(pybullet.DIRECT)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "planar.urdf"
        path.write_text(urdf(body))
        flags = pybullet.URDF_USE_INERTIA_FROM_FILE
        robot = pybullet.loadURDF(str(path), useFixedBase=True, flags=flags, physicsClientId=client)
    return robot, client


def solve(M: Any, f: tuple[float, float, float]) -> tuple[float, float, float]:
    """Return M^-1 f of a symmetric M: for three rows of floats, elimination beats a call of numpy's."""
    (a, b, c), (_, d, e), (_, _, g) = M
    f0, f1, f2 = f
    b_, c_ = b / a, c / a
    d, e, g, f1, f2 = d - b_ * b, e - b_ * c, g - c_ * c, f1 - b_ * f0, f2 - c_ * f0
    e_ = e / d
    z = (f2 - e_ * f1) / (g - e_ * e)
    y = (f1 - e * z) / d
    return (f0 - b * y - c * z) / a, y, z


def rollout(task: Task) -> Run:
    """Keep the state in floats, since Bullet takes and returns sequences of them."""
    inverse, mass_matrix = pybullet.calculateInverseDynamics, pybullet.calculateMassMatrix
    robot, client = build(task.body)
    dt, half = task.dt, task.dt**2 / 2
    zero = (0.0, 0.0, 0.0)

    def run() -> Log:
        QD, VD, AD = references(task)
        (x, y, psi), (u, w, r) = QD[0].tolist(), VD[0].tolist()
        given, block = np.hstack([QD, VD, AD]), np.empty((task.samples, 15))
        for part in chunks(task):
            rows = []
            for xd, yd, psid, ud, wd, rd, ax, ay, ar in given[part].tolist():
                q, v = (x, y, psi), (u, w, r)
                ex, ey, epsi = xd - x, yd - y, remainder(psid - psi, tau)
                cx, cy, cr = ax + GAIN * (ud - u + ex), ay + GAIN * (wd - w + ey), ar + GAIN * (rd - r + epsi)
                fx, fy, mz = force = inverse(robot, q, v, (cx, cy, cr), physicsClientId=client)
                nx, ny, nr = inverse(robot, q, v, zero, physicsClientId=client)
                M = mass_matrix(robot, q, physicsClientId=client)
                bx, by, br = solve(M, (fx - nx, fy - ny, mz - nr))
                rows.append((*q, *v, bx, by, br, *force, ex, ey, epsi))
                x, y, psi = x + dt * u + half * bx, y + dt * w + half * by, psi + dt * r + half * br
                u, w, r = u + dt * bx, w + dt * by, r + dt * br
            block[part] = rows
        return split(block)

    return run


def calls(body: Body) -> dict[str, Callable[..., Any]]:
    robot, client = build(body)
    zero = [0.0, 0.0, 0.0]

    def mass_matrix(q: np.ndarray) -> Any:
        return pybullet.calculateMassMatrix(robot, q.tolist(), physicsClientId=client)

    def inverse_dynamics(q: np.ndarray, v: np.ndarray, a: np.ndarray) -> Any:
        state = q.tolist(), v.tolist(), a.tolist()
        return pybullet.calculateInverseDynamics(robot, *state, physicsClientId=client)

    def nonlinear_effects(q: np.ndarray, v: np.ndarray) -> Any:
        return pybullet.calculateInverseDynamics(robot, q.tolist(), v.tolist(), zero, physicsClientId=client)

    return {"M": mass_matrix, "n": nonlinear_effects, "inverse": inverse_dynamics}
