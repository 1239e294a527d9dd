"""Ten thousand arms on bases: the work of every contestant, its numbers, and the check that it was done.

Robots that each have a payload, a base and friction of their own follow a circle, their joints to and fro,
under computed torque that takes each for the nominal one.
"""

from dataclasses import dataclass, field, replace
from functools import cache, cached_property, lru_cache
from math import remainder, tau

import numpy as np
import pinocchio as pin
from ensemble_contestants import Entrant
from example_robot_data import load
from fleet import Figures
from task import stepped

DT = 0.001  # [s]
KP, KD = 100.0, 20.0  # of computed torque
RADIUS, RATE = 1.0, 0.5  # of the circle [m], [rad/s]
WAY, PERIOD = 0.5, 6.0  # every joint goes so far and back [rad], [s]
MASS, SIZE = 30.0, (0.6, 0.4, 0.2)  # of the base, a homogeneous box on the ground [kg], [m]
AT = (0.1, -0.05, 0.2, 0.4)  # where the arm stands on it: x, y, z, yaw [m, m, m, rad]
TIPS = {"ur5": "tool0", "panda": "panda_hand_tcp"}  # frames that the payload is fixed to
PAYLOAD, SIDE, LEVER = 1.0, 0.1, (0.0, 0.0, 0.05)  # nominal: of a cube [kg, m], and where its middle is [m]
MIDDLE = 0.0, 0.0, SIZE[2] / 2  # of the base [m]
FINGERS = {"ur5": 0, "panda": 2}  # last joints, which hold still
FEW, LONG, SHORT = 100, PERIOD, 0.6  # so many robots move for a long time, more for a short one [s]


@dataclass(frozen=True)
class Task:
    """The arm, how long the robots move [s], and the step: ``"lecture"``, ``"euler"`` or ``"rk4"``."""

    arm: str = "ur5"
    duration: float = PERIOD
    step: str = "lecture"

    @property
    def samples(self) -> int:
        """Number of samples, the last included."""
        return round(self.duration / DT) + 1


@dataclass(frozen=True)
class ArmFleet:
    """Robots with an arm on a circle.

    Attributes
    ----------
    n : int
        Number of robots; the first ones are the same for every n.
    alike : bool
        Whether all have the first one's payload and base: easier work, for those that take a single model.
    given : bool
        Whether the forces are those of the nominal robot's closed loop: for those who run an open loop.
    """

    n: int
    alike: bool = False
    given: bool = False
    task: Task = field(default_factory=Task)

    def _drawn(self, k: int, least: float, most: float, alike: bool) -> np.ndarray:
        drawn = np.random.default_rng([1, k]).uniform(least, most, 1 if alike else self.n)
        return np.broadcast_to(drawn, (self.n,)).copy()

    @cached_property
    def payload(self) -> np.ndarray:
        """Mass of the load [kg], shape (n,)."""
        return self._drawn(0, 0.0, 3.0, self.alike)

    @cached_property
    def mass(self) -> np.ndarray:
        """Mass of the base [kg], shape (n,)."""
        return self._drawn(1, 24.0, 36.0, self.alike)

    @cached_property
    def friction(self) -> np.ndarray:
        """Viscous friction of every coordinate [N s/m, N m s/rad], shape (n,)."""
        return self._drawn(2, 0.0, 0.3, False)

    @property
    def steps(self) -> int:
        """Number of robot-steps."""
        return self.n * (self.task.samples - 1)

    @property
    def checked(self) -> list[int]:
        """Robots whose figures are checked."""
        return sorted({0, 1, 2, self.n - 1} & set(range(self.n)))


class ArmEntrant(Entrant):
    """One row of the table of arms on bases."""

    package = "arm_ensemble_contestants"

    def work(self, n: int, part: float = 1.0) -> ArmFleet:
        """Return its robots, who move for a part of the time that so many have."""
        whole = LONG if n <= FEW and "given" not in self.fleet else SHORT  # open loops leave the circle
        return self.lasting(n, part * whole)

    def lasting(self, n: int, duration: float) -> ArmFleet:
        """Return its robots, who move for so long."""
        arm, step = self.name.partition(":")[0], "rk4" if "rk4" in self.name else "lecture"
        step = "euler" if "given" in self.fleet else step
        task = Task(arm.lower(), round(duration / DT) * DT, step)
        return ArmFleet(n, task=task, **dict.fromkeys(self.fleet, True))

    def apart(self, figures: Figures, work: ArmFleet) -> float:
        """Return the largest difference of its figures from what must come out."""
        return difference(figures, work)


def motion(arm: str) -> tuple[np.ndarray, np.ndarray]:
    """Return where the joints begin [rad], and how far they go and back."""
    _, rest = loaded(arm)
    way = np.full(len(rest), WAY)
    way[len(way) - FINGERS[arm] :] = 0.0
    return rest, way


@cache
def loaded(arm: str) -> tuple[pin.Model, np.ndarray]:
    """Return an arm's model and its reference posture; its meshes take a second to read."""
    robot = load(arm)
    return robot.model, np.array(robot.q0)


@lru_cache(maxsize=8)
def references(task: Task) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return q, v and a at every sample: the circle along its tangent, cubics of the joints to and fro."""
    t = np.arange(task.samples) * DT
    angle, half = RATE * t, PERIOD / 2
    c, s = np.cos(angle), np.sin(angle)
    base = (
        (RADIUS * s, RADIUS - RADIUS * c, angle),
        (RADIUS * RATE * c, RADIUS * RATE * s, np.full_like(t, RATE)),
        (-RADIUS * RATE**2 * s, RADIUS * RATE**2 * c, np.zeros_like(t)),
    )
    back = t >= half
    part, sign = np.where(back, PERIOD - t, t) / half, np.where(back, -1.0, 1.0)
    rest, way = motion(task.arm)
    joint = (
        (3 - 2 * part) * part**2,
        sign * 6 * (1 - part) * part / half,
        (6 - 12 * part) / half**2,
    )
    starts = rest, 0.0 * rest, 0.0 * rest
    q, v, a = (
        np.column_stack([*b, start + np.outer(j, way)])
        for b, j, start in zip(base, joint, starts, strict=True)
    )
    return q, v, a


@lru_cache(maxsize=64)
def built(arm: str, held: float = PAYLOAD, mass: float = MASS) -> pin.Model:
    """Return the planar chain x, y, psi with plain angles, the base at its end, the arm, and its payload."""
    model, joint = pin.Model(), 0
    for kind, name in ((pin.JointModelPX(), "x"), (pin.JointModelPY(), "y"), (pin.JointModelRZ(), "psi")):
        joint = model.addJoint(joint, kind, pin.SE3.Identity(), name)
    inertia = pin.Inertia.FromBox(MASS, *SIZE).inertia
    model.appendBodyToJoint(joint, pin.Inertia(mass, np.array(MIDDLE), inertia), pin.SE3.Identity())
    frame = model.addFrame(pin.Frame("body", joint, 0, pin.SE3.Identity(), pin.FrameType.BODY))
    place = pin.SE3(pin.utils.rotate("z", AT[3]), np.array(AT[:3]))
    whole = pin.appendModel(model, loaded(arm)[0], frame, place)
    tip = whole.frames[whole.getFrameId(TIPS[arm])]
    whole.appendBodyToJoint(tip.parentJoint, payload(held), tip.placement)
    return whole


def payload(mass: float) -> pin.Inertia:
    """Return the load of a mass; a spread of the mass leaves the nominal inertia."""
    return pin.Inertia(mass, np.array(LEVER), pin.Inertia.FromBox(PAYLOAD, SIDE, SIDE, SIDE).inertia)


@lru_cache(maxsize=4)
def nominal_forces(task: Task) -> np.ndarray:
    """Return the force of every sample of the nominal robot's closed loop, shape (samples, nv)."""
    return _rolled(built(task.arm), built(task.arm), 0.0, replace(task, step="lecture"))[1]


@lru_cache(maxsize=256)
def _rolled(
    plant: pin.Model, known: pin.Model, friction: float, task: Task, given: bool = False
) -> tuple[np.ndarray, np.ndarray]:
    """Return error and force of every sample, (samples, nv): by mass matrices and linear solves."""
    data, model, solve = plant.createData(), known.createData(), np.linalg.solve
    QD, VD, AD = references(task)
    errors, forces = np.empty((2, *VD.shape))
    if given:
        forces = nominal_forces(task)
    q, v = QD[0], VD[0]

    def accelerated(q: np.ndarray, v: np.ndarray) -> np.ndarray:
        return solve(pin.crba(plant, data, q), force - friction * v - pin.nle(plant, data, q, v))

    for k in range(task.samples):
        e = QD[k] - q
        e[2] = remainder(e[2], tau)
        errors[k] = e
        if not given:
            wanted = AD[k] + KD * (VD[k] - v) + KP * e
            forces[k] = pin.crba(known, model, q) @ wanted + pin.nle(known, model, q, v)
        force = forces[k]
        q, v = stepped(accelerated, q, v, DT, task.step)
    return errors, forces


def expected(fleet: ArmFleet) -> Figures:
    """Return what must come out of the robots that are checked."""
    found = []
    for i in fleet.checked:
        plant = built(fleet.task.arm, float(fleet.payload[i]), float(fleet.mass[i]))
        errors, forces = _rolled(
            plant, built(fleet.task.arm), float(fleet.friction[i]), fleet.task, fleet.given
        )
        found.append((np.abs(errors).max(axis=0), np.abs(forces).max(axis=0)))
    errors, forces = map(np.array, zip(*found, strict=True))
    return Figures(errors, None, forces)


def difference(found: Figures, fleet: ArmFleet) -> float:
    """Return the largest difference of the checked robots' figures, each on its scale or 1."""
    right, apart = expected(fleet), 0.0
    for one, other in ((found.max_error, right.max_error), (found.max_input, right.max_input)):
        if one is None:
            continue
        if one.shape != (fleet.n, other.shape[1]) or not np.isfinite(one).all():
            return np.inf
        apart = max(apart, np.max(np.abs(one[fleet.checked] - other)) / max(1.0, np.max(other)))
    return float(apart)
