# %% [markdown]
# # 1 From the Denavit-Hartenberg table to M and n
#
# Lecture 45 of *Mechanics and Control of Robotic Manipulators* (S. Mohan, [NPTEL](https://nptel.ac.in))
# treats a mobile robot as a manipulator: a chain of joints with one body at its end. This notebook
# repeats every step of that derivation. It begins with the table and ends with the equations of motion
#
# $$M(q)\,\ddot q + n(q, \dot q) = \tau .$$
#
# - $q = (x, y, \psi)$ [m, m, rad]: position and heading of the body in the inertial frame {0}
# - $\tau = (F_x, F_y, M_z)$ [N, N, N m]: forces and moment on the body, along the axes of {0}
# - $M(q)$: mass matrix; $n(q, \dot q)$: nonlinear effects
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
steps = derived.steps
print(f"The derivation has {len(steps)} steps, from {steps[0].name} to {steps[-1].name}.")

# %% [markdown]
# ## The robot from above
#
# The origin of the body frame {3} is a fixed point of the body. The x axis of {3} points forward. The
# centre of mass may lie at another point.

# %%
x, y, psi = 1.6, 1.0, 0.6  # [m, m, rad]
xbc, ybc = 0.3, 0.15  # [m], larger than on a real robot, so that the figure shows them
grey = "#888888"

figure, axes = plt.subplots(figsize=(6, 4.2), layout="constrained")
turn = {"angle": np.degrees(psi), "rotation_point": (x, y)}
look = {"fill": False, "edgecolor": grey, "linewidth": 2}
axes.add_patch(Rectangle((x - 0.6, y - 0.4), 1.2, 0.8, **turn, **look))
arrows = {"angles": "xy", "scale_units": "xy", "scale": 2, "width": 0.008}
beside = {"xytext": (-18, -14), "textcoords": "offset points", "fontsize": 12}
for name, left, bottom, angle in [("{0}", 0, 0, 0), ("{3}", x, y, psi)]:
    axes.quiver(left, bottom, np.cos(angle), np.sin(angle), color=colour(1), **arrows)
    axes.quiver(left, bottom, -np.sin(angle), np.cos(angle), color=colour(2), **arrows)
    axes.annotate(name, (left, bottom), **beside)
axes.plot([x, x + 0.9], [y, y], "--", color=grey)
axes.annotate(r"$\psi$", (x + 0.35, y + 0.06), fontsize=14)
com_x = x + xbc * np.cos(psi) - ybc * np.sin(psi)
com_y = y + xbc * np.sin(psi) + ybc * np.cos(psi)
axes.plot(com_x, com_y, "o", color=colour(0), markersize=9, label="centre of mass")
axes.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
axes.set(xlim=(-0.3, 2.7), ylim=(-0.3, 1.9))
axes.set_title("The body from above: x axes orange, y axes green", fontsize=11)
axes.legend(loc="lower right")
dress(axes)

# %% [markdown]
# ## The table
#
# A body in the plane has three degrees of freedom. One row of a Denavit-Hartenberg table describes one
# joint with one degree of freedom. So the chain has two virtual links without mass between the ground
# and the body. The first joint is prismatic along y, the second is prismatic along x, and the third is
# revolute about z. The table uses Craig's
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
# A row of the library's table contains the constants only. The library adds the joint variable to
# $d_k$ of a prismatic joint and to $\theta_k$ of a revolute joint.

# %%
print("k  alpha [rad]  a [m]  theta [rad]  d [m]  joint")
for k, row in enumerate(LECTURE_TABLE, 1):
    numbers = f"{row.alpha:11.4f}  {row.a:5.1f}  {row.theta:11.4f}  {row.d:5.1f}"
    print(f"{k}  {numbers}  {row.joint.value}: {row.variable}")

# %% [markdown]
# ## Transforms
#
# Each step of the derivation has a name, a formula and an explanation. The function below displays
# steps. It abbreviates $\cos\psi$ as $c_\psi$ and $\sin\psi$ as $s_\psi$.


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
# The product of the three transforms is the pose of the body. It equals the pose that plane geometry
# gives directly. So the chain of virtual joints has the same motions as the robot.

# %%
show("T_0_3", "p", "n", "s", "a")

# %% [markdown]
# ## Velocities, from the ground outwards
#
# The components of each velocity are along the axes of its own frame. $R$ and $P$ are the rotation and
# the translation of ${}^{k-1}T_k$, and $\hat z = (0, 0, 1)$:
#
# $$\omega_k = R^T \omega_{k-1} + \dot\theta_k \hat z
# \qquad
# v_k = R^T (v_{k-1} + \omega_{k-1} \times P) + \dot d_k \hat z$$
#
# A prismatic joint has $\dot\theta_k = 0$, and a revolute joint has $\dot d_k = 0$. The units are rad/s
# and m/s.

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
# The lecture's code uses the name `a` for both. They are two quantities: the angular acceleration
# $\alpha$ has the unit rad/s², and the linear acceleration $a$ has the unit m/s².

# %%
show("alpha_3", "a_1", "a_2", "a_3", "a_0_3", "alpha_0_3")

# %% [markdown]
# ## Newton and Euler for the body
#
# Only the third link has mass. With $P_c = (x_{bc}, y_{bc}, 0)$ and $I = \mathrm{diag}(0, 0, I_{cz})$,
# its equations are
#
# $$a_c = a_3 + \alpha_3 \times P_c + \omega_3 \times (\omega_3 \times P_c)
# \qquad F_3 = m\,a_c
# \qquad N_3 = I \alpha_3 + \omega_3 \times I \omega_3$$
#
# The formula of $a_c$ below has two terms from the rotation. The yaw acceleration $\ddot\psi$ gives the
# tangential term. The yaw rate gives the centripetal term with $\dot\psi^2$, which points to the origin
# of {3}.

# %%
show("a_c3", "F_3", "N_3")

# %% [markdown]
# ## Forces and moments, back inwards
#
# Each joint transmits the force and the moment that the links after it need. Link $k-1$ exerts the force
# $f_k$ and the moment $n_k$ on link $k$:
#
# $$f_{k-1} = R\,f_k \qquad n_{k-1} = R\,n_k + P \times (R\,f_k)$$
#
# The recursion starts with $f_3 = F_3$ and $n_3 = N_3 + P_c \times F_3$. The units are N and N m.

# %%
show("f_2", "f_1", "n_3", "n_2", "n_1")

# %% [markdown]
# The last pair, $f_0$ and $n_0$, is the *shaking force* and the *shaking moment*. The ground exerts them
# on the chain. The moment is about the origin of {0}, so the lever arm of the force adds terms with $x$
# and $y$ to $n_0$.

# %%
show("f_0", "n_0")

# %% [markdown]
# ## Inputs
#
# The motor of a joint acts along the joint axis $\hat z_k$ only. The bearings carry the other
# components. So the inputs are
#
# $$\tau_1 = f_1 \cdot \hat z = F_y \qquad \tau_2 = f_2 \cdot \hat z = F_x \qquad
# \tau_3 = n_3 \cdot \hat z = M_z .$$

# %%
show("tau_2", "tau_1", "tau_3")

# %% [markdown]
# The lecture's slide has errors in these rows: some terms have $\dot\psi$ or $\dot\psi^2$ instead of
# $\ddot\psi$. The units reveal the terms with $\dot\psi$: the unit of $I_{cz}\,\dot\psi$ is not the
# N m of a moment. The units do not reveal the terms with $\dot\psi^2$.
# [Notebook 2](02_three_routes.ipynb) shows that error with numbers.
#
# ## M and n
#
# The first joint moves y and the second moves x. In the order $(x, y, \psi)$, $F_x = \tau_2$ is
# therefore the first input. $M$ contains the coefficients of the accelerations, and $n$ contains the
# terms without accelerations.

# %%
show("M", "n_v")

# %% [markdown]
# ## The slide's table
#
# A slide of the lecture shows another table for the same robot: $(3\pi/2, 0, 3\pi/2, y)$,
# $(3\pi/2, 0, 3\pi/2, x)$, $(3\pi/2, 0, 3\pi/2 + \psi, 0)$. The frames {2} of the two tables have
# different orientations. The frames {3} are equal.

# %%
from_slide = derivation.lecture(SLIDE_TABLE)
show("T_0_2", of=derived)
show("T_0_2", "T_0_3", of=from_slide)

# %% [markdown]
# The figure shows the frames of both tables at $x = 2$ m, $y = 1$ m, $\psi = 0.6$ rad. The x axes are
# orange and the y axes are green. The z axes, which are the joint axes, are blue. Frames {2} and {3}
# have the same origin, so the figure shows frame {2} 1.7 m higher.

# %%
pose_in_row_order = [1.0, 2.0, 0.6]  # y [m], x [m], psi [rad]: the order of the rows
lift = [0, 0, 1.7, 0]  # [m], of the frames {0} to {3}
label = [  # position of each label relative to its origin [m]
    (0, -0.5, -0.4),
    (0, -0.5, 0.6),
    (0, -0.6, 0.4),
    (0, -0.3, -0.5),
]

figure = plt.figure(figsize=(9, 4.6), layout="constrained")
left, right = figure.subplots(1, 2, subplot_kw={"projection": "3d"})
for axes, table, name in [(left, LECTURE_TABLE, "script"), (right, SLIDE_TABLE, "slide")]:
    for k, T in enumerate([np.eye(4), *table.placements(pose_in_row_order)]):
        at = T[:3, 3] + [0, 0, lift[k]]
        for axis, index in [(0, 1), (1, 2), (2, 0)]:
            axes.quiver(*at, *(0.8 * T[:3, axis]), color=colour(index), linewidth=2)
        axes.text(*(at + label[k]), "{" + str(k) + "}", fontsize=12)
    axes.set(xlim=(-0.5, 2.7), ylim=(-0.5, 2.3), zlim=(-0.7, 2.6))
    axes.set(xlabel="x [m]", ylabel="y [m]", zlabel="z [m]", title=f"table of the {name}")
    axes.set(xticks=[0, 1, 2], yticks=[0, 1, 2], zticks=[0, 1, 2])
    axes.set_box_aspect((3.2, 2.8, 3.3), zoom=0.92)
    axes.view_init(azim=-40)

# %% [markdown]
# ## Lagrange confirms
#
# The lecture remarks that every other method must give the same equations. Lagrange's method needs no
# joint forces and no accelerations of the links. It needs only the kinetic energy $K$ in J:
#
# $$\frac{d}{dt} \frac{\partial K}{\partial \dot q} - \frac{\partial K}{\partial q} = \tau$$

# %%
by_energy = derivation.lagrange(derived)
show("p_c3", "v_c3", "K", of=by_energy)

# %% [markdown]
# The symbolic difference of the two results is zero. So they agree for all values of the symbols:

# %%
difference = derivation.difference(derived, by_energy)
display(difference)

# %% [markdown]
# ## The claim
#
# Newton and Euler's method with either table and Lagrange's method give the same $M$ and $n$. These are
# the corrected equations of the lecture. The cell below contains them, written by hand, and compares
# the three results with them.

# %%
m, xbc, ybc, Icz, psi, rate = sympy.symbols("m xbc ybc Icz psi psidot")
c, s = sympy.cos(psi), sympy.sin(psi)
M_x_psi, M_y_psi = -m * (ybc * c + xbc * s), m * (xbc * c - ybc * s)
M = sympy.Matrix(
    [
        [m, 0, M_x_psi],
        [0, m, M_y_psi],
        [M_x_psi, M_y_psi, m * (xbc**2 + ybc**2) + Icz],
    ]
)
n = -m * rate**2 * sympy.Matrix([xbc * c - ybc * s, ybc * c + xbc * s, 0])

results = {
    "script's table": derived,
    "slide's table": from_slide,
    "Lagrange": by_energy,
}
for name, result in results.items():
    difference_n = sympy.simplify(result.nonlinear_effects - n)
    assert sympy.simplify(result.mass_matrix - M).is_zero_matrix, f"M differs: {name}"
    assert difference_n.is_zero_matrix, f"n differs: {name}"
    print(f"{name}: M and n equal those written by hand")
assert difference.is_zero_matrix, "Newton-Euler and Lagrange differ"
print("Shown: two tables and two methods give the same equations of motion.")
print("Shown: this holds for every robot and every state, since the proof is symbolic.")
