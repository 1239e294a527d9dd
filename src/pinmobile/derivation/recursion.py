"""Newton-Euler's recursion in modified-DH frames (Craig, Introduction to Robotics, 3rd ed. 2005, ch. 5-6)."""

from dataclasses import dataclass

from sympy import Expr, ImmutableMatrix

from pinmobile.derivation import wording as say
from pinmobile.derivation.joints import ZERO, Joint
from pinmobile.derivation.record import Record

__all__ = ["Recursion", "Vectors"]

Vectors = list[ImmutableMatrix]


@dataclass(frozen=True)
class Recursion:
    """Newton-Euler's recursion over a chain, for one motion.

    In every list, item k belongs to frame k and is expressed in it; item 0 is the ground.

    Attributes
    ----------
    joints : tuple of Joint
        The joints, from the ground outwards.
    v, a : tuple of sympy.Expr
        Velocities [m/s or rad/s] and accelerations [m/s^2 or rad/s^2], in the order of the rows.
    base : sympy.ImmutableMatrix, shape (3, 1)
        Acceleration of the ground [m/s^2]: upwards as fast as a body would fall.
    record : Record
        Knows the chain, and takes down the steps.
    """

    joints: tuple[Joint, ...]
    v: tuple[Expr, ...]
    a: tuple[Expr, ...]
    base: ImmutableMatrix
    record: Record

    def angular_velocities(self) -> Vectors:
        """Return omega [rad/s]."""
        omega = [ZERO]
        for k, joint in enumerate(self.joints):
            result = joint.R.T * omega[k] + joint.turn * self.v[k]
            omega.append(self.record.matrix(say.OMEGA, result, k + 1))
        return omega

    def linear_velocities(self, omega: Vectors) -> Vectors:
        """Return the velocities of the frames' origins [m/s]."""
        velocity = [ZERO]
        for k, joint in enumerate(self.joints):
            result = joint.R.T * (velocity[k] + omega[k].cross(joint.P)) + joint.slide * self.v[k]
            velocity.append(self.record.matrix(say.VELOCITY, result, k + 1))
        return velocity

    def angular_accelerations(self, omega: Vectors) -> Vectors:
        """Return alpha [rad/s^2]."""
        alpha = [ZERO]
        for k, joint in enumerate(self.joints):
            gyroscopic = (joint.R.T * omega[k]).cross(joint.turn * self.v[k])
            result = joint.R.T * alpha[k] + gyroscopic + joint.turn * self.a[k]
            alpha.append(self.record.matrix(say.ALPHA, result, k + 1))
        return alpha

    def linear_accelerations(self, omega: Vectors, alpha: Vectors) -> Vectors:
        """Return the accelerations of the frames' origins [m/s^2]."""
        a = [self.base]
        for k, joint in enumerate(self.joints):
            carried = joint.R.T * (a[k] + _lever(alpha[k], omega[k], joint.P))
            coriolis = 2 * omega[k + 1].cross(joint.slide * self.v[k])
            a.append(
                self.record.matrix(say.ACCELERATION, carried + coriolis + joint.slide * self.a[k], k + 1)
            )
        return a

    def inertial(self, omega: Vectors, alpha: Vectors, a: Vectors) -> tuple[Vectors, Vectors]:
        """Return inertial forces F [N], and moments N about the centres of mass [N m]."""
        heavy = {k: link for k, link in enumerate(self.record.chain.links, 1) if link}
        F, N = [ZERO] * len(a), [ZERO] * len(a)
        a_c = {
            k: self.record.matrix(say.ACCELERATION_COM, a[k] + _lever(alpha[k], omega[k], link.com), k)
            for k, link in heavy.items()
        }
        for k, link in heavy.items():
            F[k] = self.record.matrix(say.INERTIAL_FORCE, link.mass * a_c[k], k)
        for k, link in heavy.items():
            moment = link.inertia * alpha[k] + omega[k].cross(link.inertia * omega[k])
            N[k] = self.record.matrix(say.INERTIAL_MOMENT, moment, k)
        return F, N

    def forces(self, F: Vectors) -> Vectors:
        """Return f [N]: f_k is the force of link k - 1 on link k, and f_0 that of the ground, in frame 0."""
        f = [ZERO, *F[1:]]
        f[-1] = self.record.matrix(say.FORCE, F[-1], len(F) - 1)
        for k in range(len(F) - 2, -1, -1):
            words = say.FORCE if k else say.SHAKING_FORCE
            f[k] = self.record.matrix(words, self.joints[k].R * f[k + 1] + F[k], k)
        return f

    def moments(self, F: Vectors, N: Vectors, f: Vectors) -> Vectors:
        """Return n [N m]: the moments that belong to `f`, each about the origin of its frame."""
        com = [ZERO, *(link.com if link else ZERO for link in self.record.chain.links)]
        own = [N[k] + com[k].cross(F[k]) for k in range(len(N))]
        own[-1] = self.record.matrix(say.MOMENT, own[-1], len(N) - 1)
        for k in range(len(N) - 2, -1, -1):
            joint, words = self.joints[k], say.MOMENT if k else say.SHAKING_MOMENT
            passed_on = joint.R * own[k + 1] + joint.P.cross(joint.R * f[k + 1])
            own[k] = self.record.matrix(words, own[k] + passed_on, k)
        return own

    def inputs(self, omega: Vectors, alpha: Vectors, a: Vectors) -> tuple[Expr, ...]:
        """Return tau [N or N m] for a motion of the frames, in the order of the rows."""
        F, N = self.inertial(omega, alpha, a)
        f = self.forces(F)
        n = self.moments(F, N, f)
        tau = []
        for k, joint in enumerate(self.joints, 1):
            component = joint.slide.dot(f[k]) + joint.turn.dot(n[k])
            tau.append(self.record.scalar(say.INPUT, component, k))
        return tuple(tau)


def _lever(alpha: ImmutableMatrix, omega: ImmutableMatrix, arm: ImmutableMatrix) -> ImmutableMatrix:
    """Return how much more than the frame's origin a point at `arm` accelerates."""
    return alpha.cross(arm) + omega.cross(omega.cross(arm))
