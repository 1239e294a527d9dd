# %% [markdown]
# # 2 Three routes to the same dynamics
#
# The equations of motion of the lecture's robot,
#
# $$M(q)\,a + n(q, v) = \tau ,$$
#
# are reached here by three routes that share no code:
#
# 1. the **closed form**, derived by hand;
# 2. **[Pinocchio](https://github.com/stack-of-tasks/pinocchio)**, a rigid-body library that knows
#    nothing of the lecture: it gets joints and a body;
# 3. the **symbolic derivation** of [notebook 1](01_from_table_to_equations.ipynb),
#    by Newton and Euler and again by Lagrange.
#
# If a sign were wrong on one of them, they would not agree. Throughout, $q = (x, y, \psi)$ in m, m,
# rad; $v$ and $a$ are its derivatives; $\tau = (F_x, F_y, M_z)$ in N, N, N m.

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
# ## Route 1: the closed form
#
# $M$ is in kg, kg m and kg m²; $n$ is the centrifugal force, in N.

# %%
body = {"mass": 10, "yaw_inertia": 1.2, "com": (0.15, 0.05)}
M_by_hand = closed_form.mass_matrix(q, **body)
n_by_hand = closed_form.nonlinear_effects(q, v, mass=10, com=(0.15, 0.05))
print("M =")
print(M_by_hand)
print("n =", n_by_hand)

# %% [markdown]
# ## Route 2: Pinocchio
#
# `robot.model` is the chain in Pinocchio's own form. Its joints come in the chain's order: y, x, psi.
# The methods of `robot` put x before y, so that nobody else has to think of it.

# %%
for k in range(1, robot.model.njoints):
    print("joint", k, "is", robot.model.names[k])

M_pinocchio = robot.mass_matrix(q)
n_pinocchio = robot.nonlinear_effects(q, v)
print("M =")
print(M_pinocchio)
print("n =", n_pinocchio)

# %% [markdown]
# ## Route 3: the symbols of notebook 1, with numbers in their places

# %%
numeric = derivation.lecture().numeric()
numbers = {"m": 10, "Icz": 1.2, "xbc": 0.15, "ybc": 0.05}
M_symbolic = numeric.mass_matrix(q, numbers)
n_symbolic = numeric.nonlinear_effects(q, v, numbers)
print("M =")
print(M_symbolic)
print("n =", n_symbolic)

# %% [markdown]
# ## Numbers from outside
#
# Three routes in one library might share a mistake. Two other simulation engines,
# [MuJoCo](https://mujoco.org) 4.0 and [Drake](https://drake.mit.edu) 1.51, were given the same robot in
# the same state. Both answered, with eight digits after the point:
#
# $$M_{x\psi} = -1.34874762 \quad M_{y\psi} = 0.82515444 \quad M_{\psi\psi} = 1.45 \quad
# n = (-0.20628861,\; -0.33718691,\; 0)$$

# %%
M_outside = np.array([-1.34874762, 0.82515444, 1.45])  # MuJoCo and Drake: the last column of M
n_outside = np.array([-0.20628861, -0.33718691, 0.0])
for name, M, n in [
    ("closed form", M_by_hand, n_by_hand),
    ("Pinocchio", M_pinocchio, n_pinocchio),
    ("symbolic", M_symbolic, n_symbolic),
]:
    far = max(np.abs(M[:, 2] - M_outside).max(), np.abs(n - n_outside).max())
    print(f"{name:12} largest difference from MuJoCo and Drake: {far:.1e}")

# %% [markdown]
# They cannot be nearer than the last printed digit: half of $10^{-8}$.
#
# ## Many states
#
# One state is not many. `verify` draws 200 random ones and compares $M$, $n$, $\tau$ and the
# acceleration $a = M^{-1}(\tau - n)$ on all routes, and beside them the machine code that is made of
# the closed form where thousands of robots run side by side, as in
# [notebook 6](06_how_wrong_may_the_model_be.ipynb). Each difference is divided by the size of the terms that
# make up the quantity, so it counts rounding errors: $10^{-16}$ is one unit in the last digit of a number in
# the computer. The bound on $a$ is larger because $M^{-1}$ magnifies rounding.

# %%
verification = verify(robot)
print(verification)

# %% [markdown]
# ## Would a mistake be seen?
#
# A check that cannot fail shows nothing. A slide of the lecture has $\dot\psi^2$ where $\ddot\psi$
# belongs in $F_x$. Here are both versions beside Pinocchio's force, in a state with $\dot\psi = 0.5$
# rad/s and $\ddot\psi = 1$ rad/s²:

# %%
a = np.array([0.0, 0.0, 1.0])
# The centre of mass as seen from the origin of {3}, along the axes of {0} [m]
d_x = 0.15 * np.cos(0.7) - 0.05 * np.sin(0.7)
d_y = 0.15 * np.sin(0.7) + 0.05 * np.cos(0.7)
right = 10 * (a[0] - d_y * a[2] - d_x * v[2] ** 2)
slide = 10 * (a[0] - d_y * v[2] ** 2 - d_x * v[2] ** 2)
print(f"Fx by Pinocchio: {robot.inverse_dynamics(q, v, a)[0]:.6f} N")
print(f"Fx, put right:   {right:.6f} N")
print(f"Fx of the slide: {slide:.6f} N")

# %% [markdown]
# ## The Coriolis matrix
#
# The nonlinear effects can be written as $n = C(q, v)\,v$, with $C$ chosen so that $N = \dot M - 2C$ is
# skew-symmetric: $N + N^T = 0$. This is more than a curiosity. It says that
#
# $$\frac{d}{dt}\left(\tfrac12 v^T M v\right) = v^T \tau ,$$
#
# so only the inputs change the kinetic energy, and the proofs of many controllers rest on it. Take
# $\dot M$ from two nearby configurations on the way of the robot:

# %%
v_test = np.array([0.4, -0.3, 0.8])  # [m/s, m/s, rad/s]
C = robot.coriolis_matrix(q, v_test)
h = 1e-5  # [s]
M_dot = (robot.mass_matrix(q + h * v_test) - robot.mass_matrix(q - h * v_test)) / (2 * h)
N = M_dot - 2 * C
print("N =")
print(N)
print(f"largest entry of N + N': {np.abs(N + N.T).max():.1e}")
print(f"largest entry of C v - n: {np.abs(C @ v_test - robot.nonlinear_effects(q, v_test)).max():.1e}")

# %% [markdown]
# ## Let it coast
#
# Without any force on level ground, the energy must stay, and the centre of mass must move straight on
# at constant speed (Newton's first law), although the origin of the body frame swings about it. Nobody
# told the equations so.

# %%
no_force = np.zeros(3)


def acceleration(t, q, v):
    return robot.forward_dynamics(q, v, no_force)


dt, steps = 0.01, 1200  # [s] and how many: 12 s
q_coast = np.zeros((steps + 1, 3))
v_coast = np.zeros((steps + 1, 3))
v_coast[0] = 0.325, -0.225, 1.5  # [m/s, m/s, rad/s]
for k in range(steps):
    q_coast[k + 1], v_coast[k + 1] = rk4(acceleration, k * dt, q_coast[k], v_coast[k], dt)

psi = q_coast[:, 2]
com_x = q_coast[:, 0] + 0.15 * np.cos(psi) - 0.05 * np.sin(psi)
com_y = q_coast[:, 1] + 0.15 * np.sin(psi) + 0.05 * np.cos(psi)
energy = robot.kinetic_energy(q_coast, v_coast)
straight_x = np.linspace(com_x[0], com_x[-1], steps + 1)
straight_y = np.linspace(com_y[0], com_y[-1], steps + 1)
off_line = np.hypot(com_x - straight_x, com_y - straight_y).max()
print(f"energy at the start {energy[0]:.6f} J, largest change {np.abs(energy - energy[0]).max():.1e} J")
print(f"centre of mass off uniform straight motion by at most {off_line:.1e} m")

# %%
figure, axes = plt.subplots(figsize=(9, 2.6), layout="constrained")
axes.plot(q_coast[:, 0], q_coast[:, 1], color=colour(0), label="origin of the body frame")
axes.plot(com_x, com_y, color=colour(1), linewidth=2.5, label="centre of mass")
axes.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
axes.set_title("A robot that coasts for 12 s", fontsize=11)
figure.legend(loc="outside lower center", ncols=2, frameon=False)
dress(axes)

# %% [markdown]
# ## Linear in the parameters
#
# The forces are *linear* in the inertial parameters of the body. Pinocchio gives the matrix $Y$ with
#
# $$\tau = Y(q, v, a)\,p , \qquad
# p = (m,\; m x_{bc},\; m y_{bc},\; m z_{bc},\; I_{xx},\; I_{xy},\; I_{yy},\; I_{xz},\; I_{yz},\; I_{zz}),$$
#
# the inertias about the origin of {3}. So mass and centre of mass can be *measured*: record motions and
# forces, then solve for $p$. A robot on level ground feels only four of the ten; the rank of $Y$ says
# so.

# %%
rng = np.random.default_rng(0)
q_seen, v_seen, a_seen = rng.normal(size=(3, 50, 3))  # 50 motions
tau_seen = robot.inverse_dynamics(q_seen, v_seen, a_seen)
Y = robot.regressor(q_seen, v_seen, a_seen).reshape(150, 10)
print("rank of Y:", np.linalg.matrix_rank(Y))

felt = [0, 1, 2, 9]  # m, m xbc, m ybc, Izz
p, *_ = np.linalg.lstsq(Y[:, felt], tau_seen.reshape(150))
mass = p[0]
xbc, ybc = p[1] / mass, p[2] / mass
Icz = p[3] - mass * (xbc**2 + ybc**2)  # from the origin of {3} to the centre of mass
print(f"mass {mass:.6f} kg, com ({xbc:.6f}, {ybc:.6f}) m, Icz {Icz:.6f} kg m²")

# %% [markdown]
# ## The claim
#
# The three routes agree with one another to rounding and with MuJoCo and Drake to the last printed
# digit; $\dot M - 2C$ is skew-symmetric; a coasting robot keeps its energy and its centre of mass goes
# straight; and the regressor finds the robot's parameters in its motion.

# %%
assert verification.passed, "the routes do not agree"
for M, n in [(M_by_hand, n_by_hand), (M_pinocchio, n_pinocchio), (M_symbolic, n_symbolic)]:
    assert np.abs(M[:, 2] - M_outside).max() < 5.1e-9, "M is not that of MuJoCo and Drake"
    assert np.abs(n - n_outside).max() < 5.1e-9, "n is not that of MuJoCo and Drake"
assert abs(right - robot.inverse_dynamics(q, v, a)[0]) < 1e-12, "Fx put right is not Pinocchio's"
assert abs(slide - right) > 1, "the slide's Fx is right after all"
assert np.abs(N + N.T).max() < 1e-8, "dM/dt - 2 C is not skew-symmetric"
assert np.abs(energy - energy[0]).max() < 1e-8, "energy is lost"
assert off_line < 1e-8, "the centre of mass does not go straight"
assert np.allclose([mass, xbc, ybc, Icz], [10, 0.15, 0.05, 1.2]), "the parameters found are not the robot's"
largest = max(verification.largest.values())
print(f"Shown: three routes agree to {largest:.0e} or better, and with MuJoCo and Drake to eight digits.")
