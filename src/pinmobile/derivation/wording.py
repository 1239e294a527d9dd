"""What each kind of step is called, in words and in LaTeX; $k is its index, $n the last frame."""

from dataclasses import dataclass
from string import Template

__all__ = [
    "ALPHA",
    "ALPHA_BASE",
    "APPROACH",
    "A_BASE",
    "A_COM",
    "A_FRAME",
    "FORCE",
    "INERTIAL_FORCE",
    "INERTIAL_MOMENT",
    "INPUT_FORCE",
    "INPUT_MOMENT",
    "KINETIC",
    "LAGRANGE_INPUT",
    "LOCAL",
    "MASS",
    "MOMENT",
    "NONLINEAR",
    "NORMAL",
    "OMEGA",
    "OMEGA_BASE",
    "OMEGA_SKEW",
    "PLACEMENT",
    "POSITION",
    "POSITION_COM",
    "POTENTIAL",
    "SHAKING_FORCE",
    "SHAKING_MOMENT",
    "SLIDING",
    "V_BASE",
    "V_COM",
    "V_FRAME",
    "Wording",
]  # fmt: skip


@dataclass(frozen=True)
class Wording:
    """The texts of one kind of step.

    Attributes
    ----------
    name, title, explanation, symbol : str
        Templates of the key, the heading, one sentence and the LaTeX of the left-hand side.
    """

    name: str
    title: str
    explanation: str
    symbol: str

    def at(self, **values: object) -> tuple[str, str, str, str]:
        """Return the four texts with `values` in the place of the template's names."""
        texts = (self.name, self.title, self.explanation, self.symbol)
        name, title, explanation, symbol = (Template(text).substitute(values) for text in texts)
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
POSITION = Wording(
    "p", "Position of the last frame", "The last column of T_0_$n: where frame $n is in the base.", "p"
)
NORMAL = Wording("n", "Normal vector", "The x axis of frame $n in the base.", r"\hat{n}")
SLIDING = Wording("s", "Sliding vector", "The y axis of frame $n in the base.", r"\hat{s}")
APPROACH = Wording("a", "Approach vector", "The z axis of frame $n in the base.", r"\hat{a}")
OMEGA = Wording(
    "omega_$k",
    "Angular velocity of frame $k",
    "That of frame $j turned into frame $k, plus the rate about z_$k if joint $k is revolute.",
    r"{}^{$k}\omega_{$k}",
)
OMEGA_BASE = Wording(
    "omega_0_$n",
    "Angular velocity in the base",
    "That of frame $n, turned into the base.",
    r"{}^{0}\omega_{$n}",
)
V_FRAME = Wording(
    "v_$k",
    "Linear velocity of frame $k",
    "v + omega x P of frame $j turned into frame $k, plus the rate along z_$k if joint $k is prismatic.",
    r"{}^{$k}v_{$k}",
)
V_BASE = Wording(
    "v_0_$n",
    "Linear velocity in the base",
    "That of the origin of frame $n, turned into the base.",
    r"{}^{0}v_{$n}",
)
ALPHA = Wording(
    "alpha_$k",
    "Angular acceleration of frame $k",
    "That of frame $j turned into frame $k, plus (if joint $k is revolute) the acceleration about z_$k and "
    "the gyroscopic term of the turned omega_$j with the rate.",
    r"{}^{$k}\alpha_{$k}",
)
ALPHA_BASE = Wording(
    "alpha_0_$n",
    "Angular acceleration in the base",
    "That of frame $n, turned into the base.",
    r"{}^{0}\alpha_{$n}",
)
A_FRAME = Wording(
    "a_$k",
    "Linear acceleration of frame $k",
    "a + alpha x P + omega x (omega x P) of frame $j turned into frame $k, plus (if joint $k is prismatic) the "
    "acceleration along z_$k and the Coriolis term 2 omega x z times the rate.",
    r"{}^{$k}a_{$k}",
)
A_BASE = Wording(
    "a_0_$n",
    "Linear acceleration in the base",
    "That of the origin of frame $n, turned into the base; gravity, if any, counts as an upward acceleration.",
    r"{}^{0}a_{$n}",
)
A_COM = Wording(
    "a_c$k",
    "Acceleration of the centre of mass of link $k",
    "a + alpha x P_c + omega x (omega x P_c), with P_c the centre of mass in frame $k.",
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
    "What link $j exerts on link $k: its inertial force and the force passed on to the next link.",
    r"{}^{$k}f_{$k}",
)
SHAKING_FORCE = Wording(
    "f_0", "Shaking force", "The force of the ground on the chain, in the base.", r"{}^{0}f_{0}"
)
MOMENT = Wording(
    "n_$k",
    "Moment at joint $k",
    "What link $j exerts on link $k: N, P_c x F, and moment and force passed on to the next link.",
    r"{}^{$k}n_{$k}",
)
SHAKING_MOMENT = Wording(
    "n_0",
    "Shaking moment",
    "The moment of the ground on the chain about the origin of the base.",
    r"{}^{0}n_{0}",
)
INPUT_FORCE = Wording(
    "tau_$k",
    "Input of joint $k",
    "Joint $k ($variable) is prismatic: its input is the component of f_$k along z_$k.",
    r"\tau_{$k}",
)
INPUT_MOMENT = Wording(
    "tau_$k",
    "Input of joint $k",
    "Joint $k ($variable) is revolute: its input is the component of n_$k about z_$k.",
    r"\tau_{$k}",
)
MASS = Wording(
    "M",
    "Mass matrix",
    "The coefficients of the accelerations of ($order) in the inputs ($inputs).",
    "M(q)",
)
NONLINEAR = Wording(
    "n_v",
    "Nonlinear effects",
    "What remains of the inputs ($inputs) without acceleration.",
    r"n(q, \dot{q})",
)
POSITION_COM = Wording(
    "p_c$k",
    "Centre of mass of link $k in the base",
    "T_0_$k applied to the centre of mass of the link.",
    r"{}^{0}p_{c_{$k}}",
)
V_COM = Wording(
    "v_c$k",
    "Velocity of the centre of mass of link $k",
    "The derivative of its position with respect to time.",
    r"{}^{0}v_{c_{$k}}",
)
OMEGA_SKEW = Wording(
    "omega_0_$k",
    "Angular velocity of link $k in the base",
    "Read off the skew matrix: the derivative of R_0_$k with respect to time, times its transpose.",
    r"{}^{0}\omega_{$k}",
)
KINETIC = Wording(
    "K",
    "Kinetic energy",
    "The sum over all links of m v^2 / 2 and omega . I omega / 2.",
    "K",
)
POTENTIAL = Wording("V", "Potential energy", "The sum over all links of -m g . p_c.", "V")
LAGRANGE_INPUT = Wording(
    "tau_$k",
    "Input of joint $k",
    "Lagrange: d/dt (dL/dv) - dL/dq for $variable, with L = K - V.",
    r"\tau_{$k}",
)
