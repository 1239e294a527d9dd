"""
Equations of motion from a DH table, by two routes
==================================================

A student has the modified-DH table of a mechanism, here a cart that carries two links, and wants
M(q) and n(q, v). ``derive`` obtains them by Newton and Euler, ``lagrange`` from the energies. Their
difference is zero, in symbols. The figure shows n along a motion, as numbers.
"""

import numpy as np
from sympy import diag, pi, symbols

from pinmobile import plots
from pinmobile.derivation import Link, derive, difference, lagrange
from pinmobile.dh import DHRow, DHTable, JointType

cart = DHRow(alpha=pi / 2, a=0, theta=0, d=0, joint=JointType.PRISMATIC, variable="s")
first = DHRow(alpha=-pi / 2, a=0, theta=0, d=0, joint=JointType.REVOLUTE, variable="q1")
second = DHRow(alpha=0, a=0.5, theta=0, d=0, joint=JointType.REVOLUTE, variable="q2")
m0, m1, m2 = symbols("m0 m1 m2", positive=True)
numbers = (m0, 0, 0), (m1, 0.25, 0.1), (m2, 0.2, 0.05)  # mass, place of its centre, yaw inertia
links = [Link(m, (x, 0, 0), diag(0, 0, inertia)) for m, x, inertia in numbers]
newton = derive(DHTable((cart, first, second)), links)
print(f"M[0, 1] = {newton.mass_matrix[0, 1]}")
print(f"Newton and Euler, and Lagrange, differ by {list(difference(newton, lagrange(newton)))}")

# %%
# Along a motion:
t = np.linspace(0, 5, 26)
q = np.stack([0.3 * np.sin(t), t, np.sin(2 * t)], axis=-1)
v = np.stack([0.3 * np.cos(t), 1 + 0 * t, 2 * np.cos(2 * t)], axis=-1)
effects = newton.numeric().nonlinear_effects(q, v, {"m0": 4.0, "m1": 2.0, "m2": 1.0})
names = "force on the cart [N]", "moment of joint 1 [N m]", "moment of joint 2 [N m]"
chart = plots.curves(
    dict(zip(names, effects.T, strict=True)), x=("t", "s", t), label="nonlinear effects n [N or N m]"
)
