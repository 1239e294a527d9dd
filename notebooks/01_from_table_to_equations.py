# %% [markdown]
# # 1 From the Denavit-Hartenberg table to M and n
#
# Lecture 45 of *Mechanics and Control of Robotic Manipulators* (S. Mohan, [NPTEL](https://nptel.ac.in))
# treats a mobile robot as a manipulator: a chain of joints with one body at its end. This notebook takes
# every step of that derivation, from the table to the equations of motion
#
# $$M(q)\,\ddot q + n(q, \dot q) = \tau .$$
#
# - $q = (x, y, \psi)$ [m, m, rad]: position and heading of the body in the inertial frame {0}
# - $\tau = (F_x, F_y, M_z)$ [N, N, N m]: forces and moment on the body, along the axes of {0}
# - $m$ [kg]: mass
# - $(x_{bc}, y_{bc})$ [m]: centre of mass in the body frame {3}
# - $I_{cz}$ [kg m²]: yaw inertia about the centre of mass

# %%
import matplotlib.pyplot as plt
import numpy as np
import sympy
from IPython.display import Markdown, display
from matplotlib.patches import Rectangle

from pinmobile import derivation
from pinmobile.dh import LECTURE_TABLE, SLIDE_TABLE
from pinmobile.plots.style import colour, dress

derived = derivation.lecture()
print(len(derived.steps), "steps, from", derived.steps[0].name, "to", derived.steps[-1].name)

# %% [markdown]
# ## The robot from above
#
# The body frame {3} sits somewhere on the body, with its x axis forward. The centre of mass need not be
# there.

# %%
x, y, psi = 1.6, 1.0, 0.6  # [m, m, rad]
xbc, ybc = 0.3, 0.15  # [m], more than on a real robot, to be seen

figure, axes = plt.subplots(figsize=(6, 4.2), layout="constrained")
turn = {"angle": np.degrees(psi), "rotation_point": (x, y)}
axes.add_patch(Rectangle((x - 0.6, y - 0.4), 1.2, 0.8, **turn, fill=False, edgecolor="#888888", linewidth=2))
arrows = {"angles": "xy", "scale_units": "xy", "scale": 2, "width": 0.008}
for name, left, bottom, angle in [("{0}", 0, 0, 0), ("{3}", x, y, psi)]:
    axes.quiver(left, bottom, np.cos(angle), np.sin(angle), color=colour(1), **arrows)
    axes.quiver(left, bottom, -np.sin(angle), np.cos(angle), color=colour(2), **arrows)
    axes.annotate(name, (left, bottom), (-18, -14), textcoords="offset points", fontsize=12)
axes.plot([x, x + 0.9], [y, y], "--", color="#888888")
axes.annotate(r"$\psi$", (x + 0.35, y + 0.06), fontsize=14)
com_x = x + xbc * np.cos(psi) - ybc * np.sin(psi)
com_y = y + xbc * np.sin(psi) + ybc * np.cos(psi)
axes.plot(com_x, com_y, "o", color=colour(0), markersize=9, label="centre of mass")
axes.set(xlabel="x [m]", ylabel="y [m]", xlim=(-0.3, 2.7), ylim=(-0.3, 1.9), aspect="equal")
axes.set_title("The body from above; x axes orange, y axes green", fontsize=11)
axes.legend(loc="lower right")
dress(axes)

# %% [markdown]
# ## The table
#
# A body in the plane moves in three ways at once. A row of a Denavit-Hartenberg table describes one
# joint with one motion. So two virtual links without mass stand between the ground and the body: the
# first joint slides along y, the second along x, the third turns about z. The table is in Craig's
# ([modified](https://en.wikipedia.org/wiki/Denavit%E2%80%93Hartenberg_parameters#Modified_DH_parameters))
# form:
#
# $${}^{k-1}T_k = \mathrm{RotX}(\alpha_{k-1})\;\mathrm{TransX}(a_{k-1})\;
# \mathrm{RotZ}(\theta_k)\;\mathrm{TransZ}(d_k)$$
#
# $$\begin{array}{c|cccc|l}
# k & \alpha_{k-1} & a_{k-1} & \theta_k & d_k & \text{joint} \\ \hline
# 1 & 3\pi/2 & 0 & 3\pi/2 & y & \text{prismatic} \\
# 2 & 3\pi/2 & 0 & \pi/2 & x & \text{prismatic} \\
# 3 & \pi/2 & 0 & \pi/2 + \psi & 0 & \text{revolute}
# \end{array}$$
#
# In the library, the joint variable is left out of the row and added where it belongs.

# %%
print("k  alpha [rad]  a [m]  theta [rad]  d [m]  joint")
for k, row in enumerate(LECTURE_TABLE, 1):
    numbers = f"{row.alpha:11.4f}  {row.a:5.1f}  {row.theta:11.4f}  {row.d:5.1f}"
    print(f"{k}  {numbers}  {row.joint.value}: {row.variable}")

# %% [markdown]
# ## Transforms
#
# Every step of the derivation has a name, a formula and a sentence that says where it comes from. The
# function below shows them, with $c_\psi$ for $\cos\psi$ and $s_\psi$ for $\sin\psi$.


# %%
def show(*names, of=derived):
    for name in names:
        step = of[name]
        formula = step.latex()
        formula = formula.replace(r"\sin{\left(\psi \right)}", r"s_\psi")
        formula = formula.replace(r"\cos{\left(\psi \right)}", r"c_\psi")
        display(Markdown(f"**{step.title}.** {step.explanation}\n\n$${formula}$$"))


show("T_0_1", "T_1_2", "T_2_3")

# %% [markdown]
# Their product is the pose of the body. It is what one would write down at once for a body in the plane,
# and that is the point: the chain of virtual joints moves exactly as the robot does.

# %%
show("T_0_3", "p", "n", "s", "a")

# %% [markdown]
# ## Velocities, from the ground outwards
#
# Each frame's velocity is told along its own axes, with $R$ and $P$ the rotation and translation of
# ${}^{k-1}T_k$ and $\hat z = (0, 0, 1)$:
#
# $$\omega_k = R^T \omega_{k-1} + \dot\theta_k \hat z
# \qquad
# v_k = R^T (v_{k-1} + \omega_{k-1} \times P) + \dot d_k \hat z$$
#
# A prismatic joint has $\dot\theta_k = 0$, a revolute one $\dot d_k = 0$. The units are rad/s and m/s.

# %%
show("omega_3", "v_1", "v_2", "v_3", "v_0_3", "omega_0_3")

# %% [markdown]
# ## Accelerations, from the ground outwards
#
# $$\alpha_k = R^T \alpha_{k-1} + (R^T \omega_{k-1}) \times \dot\theta_k \hat z + \ddot\theta_k \hat z$$
#
# $$a_k = R^T \big(a_{k-1} + \alpha_{k-1} \times P + \omega_{k-1} \times (\omega_{k-1} \times P)\big)
# + 2\,\omega_k \times \dot d_k \hat z + \ddot d_k \hat z$$
#
# The lecture's code calls both of them `a`. They are two quantities: $\alpha$ in rad/s², $a$ in m/s².

# %%
show("alpha_3", "a_1", "a_2", "a_3", "a_0_3", "alpha_0_3")

# %% [markdown]
# ## Newton and Euler for the body
#
# Only the third link has mass. With $P_c = (x_{bc}, y_{bc}, 0)$ and $I = \mathrm{diag}(0, 0, I_{cz})$:
#
# $$a_c = a_3 + \alpha_3 \times P_c + \omega_3 \times (\omega_3 \times P_c)
# \qquad F_3 = m\,a_c
# \qquad N_3 = I \alpha_3 + \omega_3 \times I \omega_3$$
#
# Look at $a_c$: turning speeds up the centre of mass ($\ddot\psi$) and pulls it towards the origin of
# {3} ($\dot\psi^2$).

# %%
show("a_c3", "F_3", "N_3")

# %% [markdown]
# ## Forces and moments, back inwards
#
# Each joint carries what lies beyond it. $f_k$ and $n_k$ are what link $k-1$ exerts on link $k$:
#
# $$f_{k-1} = R\,f_k \qquad n_{k-1} = R\,n_k + P \times (R\,f_k)$$
#
# starting from $f_3 = F_3$ and $n_3 = N_3 + P_c \times F_3$. The units are N and N m.

# %%
show("f_2", "f_1", "n_3", "n_2", "n_1")

# %% [markdown]
# The last pair, $f_0$ and $n_0$, is the *shaking force* and the *shaking moment*: what the ground must
# supply to hold the chain, about the origin of {0}. The lever arm of the force brings $x$ and $y$ into
# $n_0$.

# %%
show("f_0", "n_0")

# %% [markdown]
# ## Inputs
#
# A motor acts along its own axis only, $\hat z_k$; the bearings carry the rest. So the inputs are
#
# $$\tau_1 = f_1 \cdot \hat z = F_y \qquad \tau_2 = f_2 \cdot \hat z = F_x \qquad
# \tau_3 = n_3 \cdot \hat z = M_z .$$

# %%
show("tau_2", "tau_1", "tau_3")

# %% [markdown]
# On the lecture's slide, $\dot\psi$ or $\dot\psi^2$ stands in some places of $\ddot\psi$ in these rows.
# Where it is $\dot\psi$, the units tell: $I_{cz}\,\dot\psi$ is not a moment in N m. Where it is
# $\dot\psi^2$, they do not; [notebook 2](02_three_routes.ipynb) shows it by numbers.
#
# ## M and n
#
# The first joint moves y, so $F_x = \tau_2$ comes first: in the order $(x, y, \psi)$, $M$ collects what
# multiplies the accelerations, $n$ is what remains without them.

# %%
show("M", "n_v")

# %% [markdown]
# ## The slide's table
#
# A slide of the lecture shows another table for the same robot: $(3\pi/2, 0, 3\pi/2, y)$,
# $(3\pi/2, 0, 3\pi/2, x)$, $(3\pi/2, 0, 3\pi/2 + \psi, 0)$. Its second frame points elsewhere; its last
# one is the same body.

# %%
from_slide = derivation.lecture(SLIDE_TABLE)
show("T_0_2", of=derived)
show("T_0_2", "T_0_3", of=from_slide)

# %% [markdown]
# The frames of both tables at $x = 2$ m, $y = 1$ m, $\psi = 0.6$ rad. Each has its x axis in orange, y
# in green and z in blue, the axis of its joint. Frame {2} has its origin where {3} has, so it is drawn
# above it.

# %%
pose_in_row_order = [1.0, 2.0, 0.6]  # y [m], x [m], psi [rad]: the order of the rows
lift = [0, 0, 1.7, 0]  # [m], for {2}
label = [(0, -0.5, -0.4), (0, -0.5, 0.6), (0, -0.6, 0.4), (0, -0.3, -0.5)]  # [m], beside the origins

figure, grid = plt.subplots(1, 2, figsize=(9, 4.6), subplot_kw={"projection": "3d"}, layout="constrained")
for axes, table, name in [(grid[0], LECTURE_TABLE, "script"), (grid[1], SLIDE_TABLE, "slide")]:
    for k, T in enumerate([np.eye(4), *table.placements(pose_in_row_order)]):
        at = T[:3, 3] + [0, 0, lift[k]]
        for axis, index in [(0, 1), (1, 2), (2, 0)]:
            axes.quiver(*at, *(0.8 * T[:3, axis]), color=colour(index), linewidth=2)
        axes.text(*(at + label[k]), "{" + str(k) + "}", fontsize=12)
    axes.set(xlim=(-0.5, 2.7), ylim=(-0.5, 2.3), zlim=(-0.7, 2.6), title=f"the table of the {name}")
    axes.set(xlabel="x [m]", ylabel="y [m]", zlabel="z [m]")
    axes.set(xticks=[0, 1, 2], yticks=[0, 1, 2], zticks=[0, 1, 2])
    axes.set_box_aspect((3.2, 2.8, 3.3), zoom=0.92)
    axes.view_init(azim=-40)

# %% [markdown]
# ## Lagrange confirms
#
# The lecture remarks that another method must give the same equations. Lagrange's needs neither forces
# in the joints nor accelerations, only the energy $K$ in J:
#
# $$\frac{d}{dt} \frac{\partial K}{\partial \dot q} - \frac{\partial K}{\partial q} = \tau$$

# %%
by_energy = derivation.lagrange(derived)
show("p_c3", "v_c3", "K", of=by_energy)

# %% [markdown]
# Taken from one another, the two results leave nothing, in symbols, whatever the numbers:

# %%
difference = derivation.difference(derived, by_energy)
display(difference)

# %% [markdown]
# ## The claim
#
# Both tables, by Newton and Euler, and the energy, by Lagrange, lead to the $M$ and $n$ that the lecture
# should have ended with. They are typed in here by hand.

# %%
m, xbc, ybc, Icz, psi, rate = sympy.symbols("m xbc ybc Icz psi psidot")
c, s = sympy.cos(psi), sympy.sin(psi)
M = sympy.Matrix(
    [
        [m, 0, -m * (ybc * c + xbc * s)],
        [0, m, m * (xbc * c - ybc * s)],
        [-m * (ybc * c + xbc * s), m * (xbc * c - ybc * s), m * (xbc**2 + ybc**2) + Icz],
    ]
)
n = sympy.Matrix([-m * rate**2 * (xbc * c - ybc * s), -m * rate**2 * (ybc * c + xbc * s), 0])

for name, result in [("script's table", derived), ("slide's table", from_slide), ("Lagrange", by_energy)]:
    assert sympy.simplify(result.mass_matrix - M).is_zero_matrix, f"M differs: {name}"
    assert sympy.simplify(result.nonlinear_effects - n).is_zero_matrix, f"n differs: {name}"
    print(f"{name}: M and n are the lecture's")
assert difference.is_zero_matrix, "Newton-Euler and Lagrange differ"
print("Shown: two tables and two methods give the same equations of motion, for every robot and every state.")
