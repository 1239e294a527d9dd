# %% [markdown]
# # 2 Three methods for the same dynamics
#
# The equations of motion of the lecture's robot are
#
# $$M(q)\,a + n(q, v) = \tau .$$
#
# This notebook computes them with three methods that share no code:
#
# 1. the **closed form**, derived by hand;
# 2. **[Pinocchio](https://github.com/stack-of-tasks/pinocchio)**, a rigid-body library: its input is a
#    list of joints and a body, without any equation of the lecture;
# 3. the **symbolic derivation** of [notebook 1](01_from_table_to_equations.ipynb),
#    by Newton and Euler and again by Lagrange.
#
# A wrong sign in one method would make its results differ from the others. In the whole notebook,
# $q = (x, y, \psi)$ has the units m, m, rad; $v$ and $a$ are its derivatives; and
# $\tau = (F_x, F_y, M_z)$ has the units N, N, N m.

# %%
import matplotlib.pyplot as plt
import numpy as np

from pinmobile import MobileRobot, closed_form, derivation, rk4, verify
from pinmobile.plots.style import colour, dress

np.set_printoptions(precision=8, suppress=True)

robot = MobileRobot(mass=10, yaw_inertia=1.2, com=(0.15, 0.05))  # kg, kg m², m
q = np.array([0.0, 0.0, 0.7])
v = np.array([0.0, 0.0, 0.5])
print(robot)

# %% [markdown]
# ## Method 1: the closed form
#
# The entries of $M$ have the units kg, kg m and kg m². The vector $n$ contains the centrifugal force in N.

# %%
body = {"mass": 10, "yaw_inertia": 1.2, "com": (0.15, 0.05)}
M_by_hand = closed_form.mass_matrix(q, **body)
n_by_hand = closed_form.nonlinear_effects(q, v, mass=10, com=(0.15, 0.05))
print("M =")
print(M_by_hand)
print("n =", n_by_hand)

# %% [markdown]
# ## Method 2: Pinocchio
#
# `robot.model` is Pinocchio's model of the chain. Its joints have the order of the chain: y, x, psi. The
# methods of `robot` use the order x, y, psi and convert it.

# %%
for k in range(1, robot.model.njoints):
    print("joint", k, "is", robot.model.names[k])

M_pinocchio = robot.mass_matrix(q)
n_pinocchio = robot.nonlinear_effects(q, v)
print("M =")
print(M_pinocchio)
print("n =", n_pinocchio)

# %% [markdown]
# ## Method 3: the symbolic derivation
#
# The method `numeric` converts the formulas of notebook 1 into functions of numbers.

# %%
numeric = derivation.lecture().numeric()
numbers = {"m": 10, "Icz": 1.2, "xbc": 0.15, "ybc": 0.05}
M_symbolic = numeric.mass_matrix(q, numbers)
n_symbolic = numeric.nonlinear_effects(q, v, numbers)
print("M =")
print(M_symbolic)
print("n =", n_symbolic)

# %% [markdown]
# ## Independent numbers
#
# Three methods in one library could contain the same mistake. Therefore two other simulation engines,
# [MuJoCo](https://mujoco.org) 4.0 and [Drake](https://drake.mit.edu) 1.51, computed the same robot in
# the same state. Both gave these results, rounded to eight decimals:
#
# $$M_{x\psi} = -1.34874762 \quad M_{y\psi} = 0.82515444 \quad M_{\psi\psi} = 1.45 \quad
# n = (-0.20628861,\; -0.33718691,\; 0)$$

# %%
M_outside = np.array([-1.34874762, 0.82515444, 1.45])  # last column of M
n_outside = np.array([-0.20628861, -0.33718691, 0.0])
methods = {
    "closed form": (M_by_hand, n_by_hand),
    "Pinocchio": (M_pinocchio, n_pinocchio),
    "symbolic": (M_symbolic, n_symbolic),
}
for name, (M, n) in methods.items():
    far = max(np.abs(M[:, 2] - M_outside).max(), np.abs(n - n_outside).max())
    print(f"{name:12} largest difference from MuJoCo and Drake: {far:.1e}")

# %% [markdown]
# The eight decimals limit the agreement: their rounding error is at most half of $10^{-8}$.
#
# ## Many states
#
# The comparison so far has one state. The function `verify` draws 200 random states. In each state it
# compares $M$, $n$, $\tau$ and the acceleration $a = M^{-1}(\tau - n)$ of all methods. It includes the
# machine code that the library compiles for ensembles of robots, as in
# [notebook 6](06_how_wrong_may_the_model_be.ipynb).
#
# `verify` divides each difference by the size of the terms in that quantity. So the result is a relative
# rounding error: $10^{-16}$ is about one unit in the last digit of a double-precision number. The bound
# on $a$ is larger because $M^{-1}$ amplifies rounding errors.

# %%
verification = verify(robot)
print(verification)

# %% [markdown]
# ## Does the comparison detect a mistake?
#
# A check must be able to fail. A slide of the lecture contains $\dot\psi^2$ instead of $\ddot\psi$ in
# the formula of $F_x$. The cell below compares the slide's formula and the corrected formula with
# Pinocchio's force, in a state with $\dot\psi = 0.5$ rad/s and $\ddot\psi = 1$ rad/s²:

# %%
a = np.array([0.0, 0.0, 1.0])
# Vector from the origin of {3} to the centre of mass, along the axes of {0} [m]
d_x = 0.15 * np.cos(0.7) - 0.05 * np.sin(0.7)
d_y = 0.15 * np.sin(0.7) + 0.05 * np.cos(0.7)
corrected = 10 * (a[0] - d_y * a[2] - d_x * v[2] ** 2)
slide = 10 * (a[0] - d_y * v[2] ** 2 - d_x * v[2] ** 2)
force_pinocchio = robot.inverse_dynamics(q, v, a)[0]
print(f"Fx by Pinocchio:       {force_pinocchio:.6f} N")
print(f"Fx, formula corrected: {corrected:.6f} N")
print(f"Fx, formula of slide:  {slide:.6f} N")

# %% [markdown]
# ## The Coriolis matrix
#
# The nonlinear effects have the form $n = C(q, v)\,v$. The library selects the matrix $C$ for which
# $N = \dot M - 2C$ is skew-symmetric: $N + N^T = 0$. This property implies
#
# $$\frac{d}{dt}\left(\tfrac12 v^T M v\right) = v^T \tau ,$$
#
# so only the inputs change the kinetic energy. The stability proofs of many controllers use this
# property. The cell below approximates $\dot M$ by a central difference along the velocity:

# %%
v_test = np.array([0.4, -0.3, 0.8])  # [m/s, m/s, rad/s]
C = robot.coriolis_matrix(q, v_test)
h = 1e-5  # [s]
M_after, M_before = robot.mass_matrix(q + h * v_test), robot.mass_matrix(q - h * v_test)
N = (M_after - M_before) / (2 * h) - 2 * C
n_difference = C @ v_test - robot.nonlinear_effects(q, v_test)
print("N =")
print(N)
print(f"largest entry of N + N': {np.abs(N + N.T).max():.1e}")
print(f"largest entry of C v - n: {np.abs(n_difference).max():.1e}")

# %% [markdown]
# ## A robot without forces
#
# Without a force on level ground, the kinetic energy must stay constant. The centre of mass must move
# along a straight line at constant speed (Newton's first law). The origin of the body frame moves
# around the centre of mass. The simulation does not impose these laws, so they test the equations.

# %%
no_force = np.zeros(3)


def acceleration(t, q, v):
    return robot.forward_dynamics(q, v, no_force)


dt, steps = 0.01, 1200  # time step [s] and number of steps: 12 s
q_coast = np.zeros((steps + 1, 3))
v_coast = np.zeros((steps + 1, 3))
v_coast[0] = 0.325, -0.225, 1.5  # [m/s, m/s, rad/s]
for k in range(steps):
    following = rk4(acceleration, k * dt, q_coast[k], v_coast[k], dt)
    q_coast[k + 1], v_coast[k + 1] = following

psi = q_coast[:, 2]
com_x = q_coast[:, 0] + 0.15 * np.cos(psi) - 0.05 * np.sin(psi)
com_y = q_coast[:, 1] + 0.15 * np.sin(psi) + 0.05 * np.cos(psi)
energy = robot.kinetic_energy(q_coast, v_coast)
energy_change = np.abs(energy - energy[0]).max()
straight_x = np.linspace(com_x[0], com_x[-1], steps + 1)
straight_y = np.linspace(com_y[0], com_y[-1], steps + 1)
off_line = np.hypot(com_x - straight_x, com_y - straight_y).max()
print(f"initial energy {energy[0]:.6f} J, largest change {energy_change:.1e} J")
print(f"largest distance from uniform straight motion: {off_line:.1e} m")

# %%
figure, axes = plt.subplots(figsize=(9, 2.6), layout="constrained")
origin = {"color": colour(0), "label": "origin of the body frame"}
axes.plot(q_coast[:, 0], q_coast[:, 1], **origin)
axes.plot(com_x, com_y, color=colour(1), linewidth=2.5, label="centre of mass")
axes.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
axes.set_title("Motion without forces for 12 s", fontsize=11)
figure.legend(loc="outside lower center", ncols=2, frameon=False)
dress(axes)

# %% [markdown]
# ## Linear in the parameters
#
# The forces are *linear* in the inertial parameters of the body. Pinocchio computes the regressor
# matrix $Y$ with
#
# $$\tau = Y(q, v, a)\,p , \qquad
# p = (m,\; m x_{bc},\; m y_{bc},\; m z_{bc},\; I_{xx},\; I_{xy},\; I_{yy},\; I_{xz},\; I_{yz},\; I_{zz}).$$
#
# The inertias are about the origin of {3}. Because of this form, recorded motions and forces determine
# parameters by linear least squares. On level ground, only four of the ten parameters are identifiable:
# the rank of $Y$ is four.

# %%
rng = np.random.default_rng(0)
q_log, v_log, a_log = rng.normal(size=(3, 50, 3))  # 50 states and accelerations
tau_log = robot.inverse_dynamics(q_log, v_log, a_log)
Y = robot.regressor(q_log, v_log, a_log).reshape(150, 10)
print("rank of Y:", np.linalg.matrix_rank(Y))

identifiable = [0, 1, 2, 9]  # m, m xbc, m ybc, Izz
p, *_ = np.linalg.lstsq(Y[:, identifiable], tau_log.reshape(150))
mass = p[0]
xbc, ybc = p[1] / mass, p[2] / mass
Icz = p[3] - mass * (xbc**2 + ybc**2)  # parallel axis theorem: from {3} to the centre of mass
print(f"mass {mass:.6f} kg, com ({xbc:.6f}, {ybc:.6f}) m, Icz {Icz:.6f} kg m²")

# %% [markdown]
# ## The claim
#
# The three methods agree up to rounding, and they agree with MuJoCo and Drake to the last printed digit.
# The matrix $\dot M - 2C$ is skew-symmetric. A robot without forces keeps its energy, and its centre of
# mass moves along a straight line. The regressor identifies the robot's parameters from its motion.

# %%
assert verification.passed, "the methods disagree"
for name, (M, n) in methods.items():
    far = max(np.abs(M[:, 2] - M_outside).max(), np.abs(n - n_outside).max())
    assert far < 5.1e-9, f"MuJoCo and Drake give other numbers than the method: {name}"
assert abs(corrected - force_pinocchio) < 1e-12, "the corrected Fx differs from Pinocchio"
assert abs(slide - corrected) > 1, "the comparison does not detect the slide's mistake"
assert np.abs(N + N.T).max() < 1e-8, "dM/dt - 2 C is not skew-symmetric"
assert energy_change < 1e-8, "the energy changes"
assert off_line < 1e-8, "the centre of mass leaves the straight line"
found = [mass, xbc, ybc, Icz]
assert np.allclose(found, [10, 0.15, 0.05, 1.2]), "the parameters differ from the robot"
largest = max(verification.largest.values())
print(f"Shown: the three methods agree within {largest:.0e}.")
print("Shown: they agree with MuJoCo and Drake to eight decimals.")
