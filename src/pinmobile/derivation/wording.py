"""What each kind of step is called, in words and in LaTeX."""

from __future__ import annotations

from dataclasses import dataclass
from string import Template

from pinmobile.dh import DHRow, JointType


@dataclass(frozen=True)
class Wording:
    """The texts of one kind of step.

    In all of them $k stands for the index, $j for the one before, $n for the last frame.

    Attributes
    ----------
    name, title, explanation, symbol : str
        Key, heading, one sentence, and the LaTeX of the left-hand side.
    prismatic, revolute : str
        What stands for $extra in the explanation, according to joint k.
    """

    name: str
    title: str
    explanation: str
    symbol: str
    prismatic: str = ""
    revolute: str = ""

    def at(self, k: int, last: int, row: DHRow, **texts: str) -> tuple[str, str, str, str]:
        """Return name, title, explanation and symbol for index `k`, whose row is `row`."""
        extra = self.revolute if row.joint is JointType.REVOLUTE else self.prismatic
        values = {"k": k, "j": k - 1, "n": last, "joint": row.joint.value, "variable": row.variable, **texts}
        templates = (self.name, self.title, self.explanation.replace("$extra", extra), self.symbol)
        name, title, explanation, symbol = (Template(text).substitute(values) for text in templates)
        return name, title, explanation, symbol


LOCAL = Wording(
    "T_${j}_$k",
    "Transform of joint $k",
    "RotX(alpha) TransX(a) RotZ(theta) TransZ(d) of row $k of the table: the pose of frame $k in frame $j.",
    r"{}^{$j}T_{$k}",
)
PLACEMENT = Wording(
    "T_0_$k",
    "Pose of frame $k in the base",
    "The product of the first $k transforms.",
    r"{}^{0}T_{$k}",
)
POSITION = Wording("p", "Position", "Where frame $n is in the base: the last column of T_0_$n.", "p")
NORMAL = Wording("n", "Normal vector", "The x axis of frame $n in the base.", r"\hat{n}")
SLIDING = Wording("s", "Sliding vector", "The y axis of frame $n in the base.", r"\hat{s}")
APPROACH = Wording("a", "Approach vector", "The z axis of frame $n in the base.", r"\hat{a}")
OMEGA = Wording(
    "omega_$k",
    "Angular velocity of frame $k",
    "That of frame $j, turned into frame $k$extra.",
    r"{}^{$k}\omega_{$k}",
    revolute=", plus the rate about z_$k",
)
OMEGA_BASE = Wording(
    "omega_0_$n",
    "Angular velocity in the base",
    "That of frame $n, turned into the base.",
    r"{}^{0}\omega_{$n}",
)
VELOCITY = Wording(
    "v_$k",
    "Linear velocity of frame $k",
    "v + omega x P of frame $j, turned into frame $k$extra.",
    r"{}^{$k}v_{$k}",
    prismatic=", plus the rate along z_$k",
)
VELOCITY_BASE = Wording(
    "v_0_$n",
    "Linear velocity in the base",
    "That of the origin of frame $n, turned into the base.",
    r"{}^{0}v_{$n}",
)
ALPHA = Wording(
    "alpha_$k",
    "Angular acceleration of frame $k",
    "That of frame $j, turned into frame $k$extra.",
    r"{}^{$k}\alpha_{$k}",
    revolute=", plus the gyroscopic term (the turned omega_$j) x z_$k times the rate, "
    "plus the acceleration about z_$k",
)
ALPHA_BASE = Wording(
    "alpha_0_$n",
    "Angular acceleration in the base",
    "That of frame $n, turned into the base.",
    r"{}^{0}\alpha_{$n}",
)
ACCELERATION = Wording(
    "a_$k",
    "Linear acceleration of frame $k",
    "a + alpha x P + omega x (omega x P) of frame $j, turned into frame $k$extra.",
    r"{}^{$k}a_{$k}",
    prismatic=", plus the Coriolis term 2 omega_$k x z_$k times the rate, plus the acceleration along z_$k",
)
ACCELERATION_BASE = Wording(
    "a_0_$n",
    "Linear acceleration in the base",
    "That of the origin of frame $n, turned into the base; gravity counts as an acceleration upwards.",
    r"{}^{0}a_{$n}",
)
ACCELERATION_COM = Wording(
    "a_c$k",
    "Acceleration of the centre of mass of link $k",
    "a + alpha x P_c + omega x (omega x P_c), where P_c is the centre of mass in frame $k.",
    r"{}^{$k}a_{c_{$k}}",
)
INERTIAL_FORCE = Wording(
    "F_$k",
    "Inertial force of link $k",
    "Newton: mass times the acceleration of the centre of mass.",
    r"{}^{$k}F_{$k}",
)
INERTIAL_MOMENT = Wording(
    "N_$k",
    "Inertial moment of link $k",
    "Euler: I alpha + omega x (I omega), about the centre of mass.",
    r"{}^{$k}N_{$k}",
)
FORCE = Wording(
    "f_$k",
    "Force at joint $k",
    "What link $j exerts on link $k: its inertial force, and the force passed on to the next link.",
    r"{}^{$k}f_{$k}",
)
SHAKING_FORCE = Wording("f_0", "Shaking force", "What the ground exerts on the chain.", r"{}^{0}f_{0}")
MOMENT = Wording(
    "n_$k",
    "Moment at joint $k",
    "What link $j exerts on link $k: N + P_c x F, and n + P x f passed on to the next link.",
    r"{}^{$k}n_{$k}",
)
SHAKING_MOMENT = Wording(
    "n_0",
    "Shaking moment",
    "What the ground exerts on the chain, about the origin of the base.",
    r"{}^{0}n_{0}",
)
INPUT = Wording(
    "tau_$k",
    "Input of joint $k",
    "The joint of $variable is $joint: its input is $extra.",
    r"\tau_{$k}",
    prismatic="the component of f_$k along z_$k",
    revolute="the component of n_$k about z_$k",
)
MASS_MATRIX = Wording(
    "M",
    "Mass matrix",
    "The coefficients of the accelerations of ($order) in the inputs ($inputs).",
    "M(q)",
)
NONLINEAR_EFFECTS = Wording(
    "n_v",
    "Nonlinear effects",
    "What remains of the inputs ($inputs) without acceleration.",
    r"n(q, \dot{q})",
)
POSITION_COM = Wording(
    "p_c$k",
    "Centre of mass of link $k",
    "T_0_$k applied to the centre of mass in frame $k.",
    r"{}^{0}p_{c_{$k}}",
)
VELOCITY_COM = Wording(
    "v_c$k",
    "Velocity of the centre of mass of link $k",
    "The derivative of its position with respect to time.",
    r"{}^{0}v_{c_{$k}}",
)
OMEGA_SKEW = Wording(
    "omega_0_$k",
    "Angular velocity of link $k",
    "Read off the skew matrix: the derivative of R_0_$k with respect to time, times the transpose of R_0_$k.",
    r"{}^{0}\omega_{$k}",
)
VELOCITY_OWN = Wording(
    "v_own$k",
    "Velocity of the centre of mass of link $k in its own axes",
    "The velocity, turned into frame $k.",
    r"{}^{$k}v_{c_{$k}}",
)
OMEGA_OWN = Wording(
    "omega_own$k",
    "Angular velocity of link $k in its own axes",
    "The angular velocity, turned into frame $k.",
    r"{}^{$k}\omega_{$k}",
)
KINETIC = Wording("K", "Kinetic energy", "The sum over all links of m v . v / 2 + omega . I omega / 2.", "K")
POTENTIAL = Wording("V", "Potential energy", "The sum over all links of -m g . p_c.", "V")
MOMENTUM = Wording(
    "P_$k",
    "Generalised momentum of $variable",
    "The derivative of L = K - V with respect to the rate of $variable.",
    r"\frac{\partial L}{\partial \dot{q}_{$k}}",
)
LAGRANGE = Wording(
    "tau_$k",
    "Input of joint $k",
    "Lagrange: the derivative of P_$k with respect to time, less that of L with respect to $variable.",
    r"\tau_{$k}",
)
