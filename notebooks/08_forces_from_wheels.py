# %% [markdown]
# # 8 Forces from wheels: which drive can do what
#
# In the previous notebooks the force $\tau = (F_x, F_y, M_z)$ acted on the body, and
# its source was not modelled. On a real robot the wheels exert this force, and they
# cannot exert every force. Two wheels on one axle, for example, exert no force to the
# side. The notebook answers three questions:
#
# - How does the equation $M(q)\,\ddot q + n(q, \dot q) = \tau$ change on wheels?
# - Which forces can each drive apply?
# - How do the lecture's controllers follow the lecture's paths on wheels?
#
# Here the wheels roll and never slip. Notebook 9 adds the friction limit of the ground.

# %%
from itertools import product

import matplotlib.pyplot as plt
import numpy as np
import sympy
from IPython.display import Markdown, display
from matplotlib.patches import Polygon, Rectangle
from scipy.linalg import null_space
from scipy.spatial import ConvexHull

from pinmobile import (
    PD,
    Backstepping,
    Circle,
    ComputedTorque,
    ControlAllocation,
    CubicVia,
    Engine,
    FixedHeading,
    InvalidArgument,
    MobileRobot,
    Motor,
    Tangent,
    UnicycleTracking,
    WheeledRobot,
    WheelTable,
    closed_form,
    derivation,
    simulate,
    verify,
)
from pinmobile.plots.style import INK, colour, dress, tint
from pinmobile.trajectories import LectureHeading

np.set_printoptions(precision=3, suppress=True, linewidth=110)

# %% [markdown]
# ## The wheel table
#
# The Denavit-Hartenberg table has one row per joint. The wheel table has one row per
# wheel. A row contains the wheel's position in the body frame, its radius and its
# rolling direction. It also states whether the wheel is steered, whether it has rollers
# and at which angle, and whether it has a motor. The first example has two wheels on
# one axle and a caster behind them:

# %%
wheels = WheelTable.differential(
    track=0.5, radius=0.1, supports=[(-0.3, 0)], mass=1.0, spin_inertia=0.005, yaw_inertia=0.003
)
print(wheels)

# %% [markdown]
# The last three lines follow from the rows alone. A tyre obeys two equations: its
# contact point moves neither along its direction nor across it. For all wheels
# together, these equations are $A(q)\,\dot q = 0$. The wheel angles are coordinates
# too, so $q = (x, y, \psi, \varphi_L, \varphi_R)$. The **rank** is the number of
# independent rows. The remaining velocities are independent; the output calls them
# free.
#
# The **type** counts the motions of the body (Campion, Bastin and d'Andrea-Novel,
# 1996). The *mobility* is the number of directions in which the body can start at once.
# The *steerability* is the number of steering angles that can be chosen. The next cell
# compares other drives of about the same size:

# %%
own = {"radius": 0.1, "mass": 0.5, "spin_inertia": 0.0025, "yaw_inertia": 0.0013}
own["motor"] = Motor(2.0)
tables = {
    "differential": WheelTable.differential(0.4, supports=[(-0.25, 0)], **own),
    "car": WheelTable.car(0.5, 0.4, **own),
    "two swerve modules": WheelTable.swerve([(0.25, 0.2), (-0.25, -0.2)], **own),
    "mecanum": WheelTable.mecanum(0.5, 0.4, **own),
    "three omni wheels": WheelTable.omni(0.3, **own),
    "skid-steer": WheelTable.skid_steer(0.5, 0.4, **own),
}
body = MobileRobot(30.0, 1.3, com=(0.1, 0.05, 0.2))
drives = {name: WheeledRobot(body, table) for name, table in tables.items()}
print(f"{'':19} coordinates  rows  rank  independent velocities  type    motors")
ranks = {}
for name, drive in drives.items():
    able = drive.mobility
    rows, columns = able.matrix.shape
    ranks[name] = columns, rows, able.rank, able.mobility, able.steerability
    free = columns - able.rank if able.is_regular else "none"
    numbers = f"{columns:11}  {rows:4}  {able.rank:4}  {free:>22}"
    print(f"{name:19} {numbers}  ({able.mobility}, {able.steerability})  {drive.nu:6}")
print(f"\nskid-steer {drives['skid-steer'].mobility.rolling_obstacle}.")

# %% [markdown]
# A drive of mobility 3 can start in any direction. A drive of mobility 2 can only start
# straight ahead and about the vertical axis. The bodies of the car and of the two
# swerve modules have one direction at each choice of steering angles. The skid-steer
# base can roll straight ahead, but it cannot turn without slip. Notebook 9 treats this
# base.
#
# ## The equations of motion, step by step
#
# The derivation follows the lecture: it uses symbols and proceeds one step at a time.
# Half the track is $b$, the wheel radius is $r$, and the inertia of each wheel about
# its axle is $I_w$. The mass $m$, the centre of mass $(x_{bc}, y_{bc})$ and $I_{cz}$
# describe body and wheels together. The origin of the body frame is the middle of the
# axle. In the output, a dot denotes a rate, $c_\psi = \cos\psi$ and
# $s_\psi = \sin\psi$.

# %%
m, xbc, ybc, Icz, Iw, r, b = sympy.symbols("m x_bc y_bc I_cz I_w r b", positive=True)
x, y, psi, left, right = q = sympy.Matrix(sympy.symbols("x y psi varphi_L varphi_R", real=True))
rates = sympy.Matrix([sympy.Symbol(rf"\dot{{{sympy.latex(one)}}}", real=True) for one in q])
speed, turn = nu = sympy.Matrix(sympy.symbols("v omega", real=True))
tau = sympy.Matrix(sympy.symbols("tau_L tau_R", real=True))


def show(title, symbol, result, text=""):
    """Show the title, the text and the formula of a step."""
    formula = sympy.latex(result)
    formula = formula.replace(r"\sin{\left(\psi \right)}", r"s_\psi")
    formula = formula.replace(r"\cos{\left(\psi \right)}", r"c_\psi")
    display(Markdown(f"**{title}.** {text}\n\n$${symbol} = {formula}$$"))


c, s = sympy.cos(psi), sympy.sin(psi)
to_body = sympy.Matrix([[c, s], [-s, c]])
slip = []
for side, spin in ((b, rates[3]), (-b, rates[4])):
    centre = to_body * rates[:2, :] + rates[2] * sympy.Matrix([-side, 0])
    slip += [centre[0] - r * spin, centre[1]]
show(
    "Velocity at the ground",
    r"(s_{L,\mathrm{along}}, s_{L,\mathrm{across}}, "
    r"s_{R,\mathrm{along}}, s_{R,\mathrm{across}})^T",
    sympy.Matrix(slip),
    "The velocity of the wheel centre at $(0, \\pm b)$ in body axes, minus the rolling velocity.",
)
A = sympy.Matrix(slip).jacobian(rates)
text = "It multiplies the rates. Rows two and four are equal, so the rank is 3."
show("Constraint matrix", "A(q)", A, text)

# %% [markdown]
# Three independent equations restrict the five rates, so two velocities are
# independent. They are the speed $v$ of the middle of the axle and the yaw rate
# $\omega$. They determine all rates by $\dot q = S(q)\,\nu$ with $\nu = (v, \omega)$:

# %%
S = sympy.Matrix([[c, 0], [s, 0], [0, 1], [1 / r, -b / r], [1 / r, b / r]])
show("Null-space basis", "S(q)", S, "Each column is a motion without slip.")
assert sympy.simplify(A * S) == sympy.zeros(4, 2)
assert A.rank() == 3
print("A S = 0 for every heading")

# %% [markdown]
# The lecture's $M$ and $n$, derived in notebook 1, describe body and wheels together,
# with locked wheels. A spinning wheel only adds its inertia about the axle. It is a
# solid of revolution, so its spin moves no other mass. The motor torque acts on the
# angle of its wheel only:

# %%
lecture = derivation.lecture()
names = sympy.symbols("m xbc ybc Icz psi psidot")
given = dict(zip(names, (m, xbc, ybc, Icz, psi, rates[2]), strict=True))
symbols = lecture.mass_matrix.free_symbols | lecture.nonlinear_effects.free_symbols
named = {symbol: given[sympy.Symbol(symbol.name)] for symbol in symbols}
M = sympy.diag(lecture.mass_matrix.subs(named), Iw, Iw)
n = sympy.Matrix([*lecture.nonlinear_effects.subs(named), 0, 0])
B = sympy.Matrix([[0, 0], [0, 0], [0, 0], [1, 0], [0, 1]])
show("Mass matrix with wheels", "M(q)", M)
show("Nonlinear effects", "n^T", n.T)

# %% [markdown]
# The ground exerts constraint forces $\lambda$ along the rows of $A$:
#
# $$M \ddot q + n = B\,\tau + A^T \lambda .$$
#
# These forces are unknown. But constraint forces do no work on a motion without slip:
# $S^T A^T = 0$. Insert $\ddot q = S \dot\nu + \dot S \nu$ and multiply by $S^T$ from
# the left. Then the constraint forces vanish:
#
# $$\underbrace{S^T M S}_{\bar M}\,\dot\nu + \underbrace{S^T (M \dot S \nu + n)}_{\bar n}
# = \underbrace{S^T B}_{\bar B}\,\tau$$

# %%
rolls = {rates[2]: turn}
S_dot = S.diff(psi) * turn
M_bar = (S.T * M * S).applyfunc(sympy.simplify)
n_bar = (S.T * (M * S_dot * nu + n.subs(rolls))).applyfunc(sympy.simplify)
B_bar = S.T * B
show("Reduced mass matrix", r"\bar M", M_bar, "It does not depend on the heading.")
text = "They vanish if the centre of mass lies on the line of the axle."
show("Reduced nonlinear effects", r"\bar n", n_bar, text)
text = "The sum of the torques drives the robot, and their difference turns it."
show("Reduced input matrix", r"\bar B", B_bar, text)

# %% [markdown]
# Two equations replace five, and each term has a meaning. The inertia of a wheel counts
# as the mass $I_w / r^2$. If the robot turns, a centre of mass ahead of the axle
# accelerates it forward ($-m\,x_{bc}\,\omega^2$). If it also drives forward, the moment
# $m\,x_{bc}\,v\,\omega$ acts against the turn. So a mass ahead of the axle keeps the
# robot straight. A mass behind the axle makes it spin.
#
# Which forces act at the wheels? The equation of each wheel gives the force along it.
# Two rows of $A$ are equal, so one equation gives the sum of the two forces across the
# axle. A model with rigid wheels cannot determine how the left and right wheel share
# this sum.

# %%
nu_rate = sympy.Matrix(sympy.symbols(r"\dot{v} \dot{\omega}", real=True))
unknown = B * tau - M * (S * nu_rate + S_dot * nu) - n.subs(rolls)  # it is -A' lambda
along = [sympy.expand(unknown[3 + k] / r) for k in range(2)]
sideways = sympy.simplify(-(-s * unknown[0] + c * unknown[1]))
show("Forces along the wheels", r"(\lambda_L, \lambda_R)", sympy.Matrix([along]))
show("Sum of the forces across the axle", "Y", sympy.expand(sideways))

# %% [markdown]
# ## Three methods
#
# - By hand: the two equations above. The library has them as
#   `closed_form.differential_drive`.
# - By null space: a numerical null-space basis of $A$, with $M$, $n$ and $A$ from
#   Pinocchio's tree of bodies.
# - By KKT: all accelerations and all constraint forces at once, without elimination,
#   from
#
# $$\begin{pmatrix} M & A^T \\ A & 0 \end{pmatrix}
# \begin{pmatrix} \ddot q \\ -\lambda \end{pmatrix} =
# \begin{pmatrix} B \tau - n \\ -\dot A \dot q \end{pmatrix}$$
#
# The last equations are the conditions of Karush, Kuhn and Tucker (KKT) for Gauss's
# principle of least constraint. The next cell compares the methods at 200 random states
# and torques:

# %%
robot = WheeledRobot(body, wheels)
numbers = {m: 30.0, xbc: 0.1, ybc: 0.05, Icz: 1.3, Iw: 0.005, r: 0.1, b: 0.25}
symbolic = sympy.lambdify(list(nu), [one.subs(numbers) for one in (M_bar, n_bar)])
formulas = [formula.subs(numbers) for formula in (*along, sideways)]
forces = sympy.lambdify([*nu, *nu_rate, *tau], formulas)
given = {"mass": 30.0, "yaw_inertia": 1.3, "com": (0.1, 0.05)}
given |= {"track": 0.5, "radius": 0.1, "spin_inertia": 0.005}
generator = np.random.default_rng(0)
differences = {"printed above": 0.0, "null space": 0.0, "KKT": 0.0, "forces": 0.0}
for _ in range(200):
    where = np.append(generator.uniform(-3, 3, 3), generator.uniform(-9, 9, 2))
    going, torques = generator.uniform(-2, 2, 2), generator.uniform(-5, 5, 2)
    rolling = robot.reduced(where, np.zeros(5)).S @ going
    hand = closed_form.differential_drive(going, **given)
    by_hand = np.linalg.solve(hand.M, hand.B @ torques - hand.n)
    printed = symbolic(*going)
    off = np.abs(printed[0] - hand.M).max(), np.abs(printed[1][:, 0] - hand.n).max()
    differences["printed above"] = max(differences["printed above"], *off)
    matrices = robot.mass_matrix(where), robot.nonlinear_effects(where, rolling)
    rows, bias = robot.constraint_matrix(where), robot.constraint_drift(where, rolling)
    pushed = robot.input_matrix @ torques - matrices[1]
    basis = null_space(rows)
    kept = -np.linalg.pinv(rows) @ bias
    reduced = basis.T @ matrices[0] @ basis
    by_space = kept + basis @ np.linalg.solve(reduced, basis.T @ (pushed - matrices[0] @ kept))
    whole = np.block([[matrices[0], rows.T], [rows, np.zeros((4, 4))]])
    found = np.linalg.lstsq(whole, np.concatenate([pushed, -bias]), rcond=1e-12)[0]
    heading = np.array([np.cos(where[2]), np.sin(where[2])])
    for name, a in (("null space", by_space), ("KKT", found[:5])):
        off = abs(heading @ a[:2] - by_hand[0]), abs(a[2] - by_hand[1])
        differences[name] = max(differences[name], *off)
    predicted = forces(*going, *by_hand, *torques)
    solved = -found[5:]
    solved = np.array([solved[0], solved[2], solved[1] + solved[3]])
    differences["forces"] = max(differences["forces"], np.abs(solved - predicted).max())
units = "kg m^2, N m", "m/s^2, rad/s^2", "m/s^2, rad/s^2", "N"
for name, unit in zip(differences, units, strict=True):
    print(f"by hand against {name:14} largest difference {differences[name]:.0e} {unit}")

# %% [markdown]
# The function `verify` makes such a table for every drive, with more methods:

# %%
report = verify(robot)
print(report)

# %% [markdown]
# ## Which forces can a drive apply?
#
# Each motor exerts at most 2 N m. A wheel of radius $r$ without rollers then exerts up
# to $2\,\mathrm{N\,m} / r = 20$ N along its direction. A roller spins freely about its
# axis. The ground can therefore push a wheel with rollers only along the axis of the
# roller in contact. For all wheels together, the wrench on the body is
#
# $$\tau_{\mathrm{body}} = J^T \tau_{\mathrm{wheels}},$$
#
# with the matrix $J$ that gives the wheel rates from the velocity of the body.

# %%
angles = {"car": [0.4], "two swerve modules": [0.5, -0.3]}  # [rad]
able = {name: drive for name, drive in drives.items() if name != "skid-steer"}


def wrenches(name):
    """Return the wrench on the body per torque of each motor, shape (3, motors)."""
    drive, steering = able[name], angles.get(name, ())
    J = drive.wheel_rates(np.eye(3), np.tile(steering, (3, 1)) if steering else ())
    turned = drive.input_matrix[-len(drive.table) :]
    return J @ turned[:, np.abs(turned).max(axis=0) > 0]


def draw_from_above(axes, name):
    """Draw the wheels, and arrows along the forces of the ground."""
    table, steering = able[name].table, dict(enumerate(angles.get(name, ())))
    axes_of_table = enumerate(table.axes)
    turned = {row: steering[k] for k, axis in axes_of_table for row in axis.wheels}
    driven = able[name].input_matrix[-len(table) :].any(axis=1)
    for row, wheel in enumerate(table.wheels):
        angle = wheel.angle + turned.get(row, 0.0)
        along = angle + (wheel.roller or 0.0)
        about = {"angle": np.degrees(angle), "rotation_point": (wheel.x, wheel.y)}
        corner = wheel.x - 0.1, wheel.y - 0.03
        axes.add_patch(Rectangle(corner, 0.2, 0.06, **about, color="#c8ccd0"))
        if driven[row]:
            tip = wheel.x + 0.2 * np.cos(along), wheel.y + 0.2 * np.sin(along)
            arrow = {"arrowstyle": "-|>", "color": colour(1), "linewidth": 1.8}
            axes.annotate("", tip, (wheel.x, wheel.y), arrowprops=arrow)
    axes.plot(0, 0, "+", color=INK)
    middle = np.mean([wheel.x for wheel in table.wheels])
    axes.set(xlim=(middle - 0.55, middle + 0.55), ylim=(-0.55, 0.55))
    axes.set(aspect="equal", xlabel="x [m]")
    axes.set_title(name, fontsize=11)


def draw_reach(axes, W, rows):
    """Draw two components of the wrenches that torques of up to 2 N m exert."""
    extremes = product((-2.0, 2.0), repeat=W.shape[1])
    corners = np.array([W @ torques for torques in extremes])[:, rows]
    if np.linalg.matrix_rank(corners, tol=1e-9) == 2:
        edge = corners[ConvexHull(corners).vertices]
        fill = {"facecolor": tint(colour(0), 0.25), "edgecolor": colour(0)}
        axes.add_patch(Polygon(edge, **fill, linewidth=1.8))
    else:
        ends = corners[np.argsort(corners @ [1.0, 1e-3])[[0, -1]]]
        axes.plot(*ends.T, color=colour(0), linewidth=4, solid_capstyle="butt")


figure, grid = plt.subplots(3, 5, figsize=(12, 7.4), layout="constrained")
applied = {}
for (name, _), (above, force, moment) in zip(able.items(), grid.T, strict=True):
    applied[name] = W = wrenches(name)
    draw_from_above(above, name)
    draw_reach(force, W, [0, 1])
    draw_reach(moment, W, [0, 2])
    force.set(xlim=(-95, 95), ylim=(-95, 95), aspect="equal", xlabel="$F_x$ [N]")
    moment.set(xlim=(-95, 95), ylim=(-42, 42), xlabel="$F_x$ [N]")
for row, label in zip(grid, ("y [m]", "$F_y$ [N]", "$M_z$ [N m]"), strict=True):
    row[0].set_ylabel(label)
for axes in grid.ravel():
    dress(axes)
figure.suptitle("Top: drives and forces on driven wheels. Below: wrenches that motors can exert")
reach = {name: np.linalg.matrix_rank(W, tol=1e-9) for name, W in applied.items()}
print("dimension of the set of wrenches that motors can exert:")
print(", ".join(f"{name} {k}" for name, k in reach.items()))

# %% [markdown]
# The blue sets are the wrenches that the motors can exert. The differential drive has a
# line in the middle row: it exerts no force to the side. The car has a line in both
# rows: it only exerts a force normal to the rear axle. Mecanum and omni wheels fill all
# three dimensions. A motor of a mecanum wheel exerts the same forward force of 20 N as
# a motor of a tyre. The rollers add directions, not forward force.
#
# The ground also exerts side forces on the front wheels of the car, and these forces
# turn the car. But no motor commands them: they are constraint forces $\lambda$.
#
# ## Allocation and residual
#
# Each drive now receives the same wrench: 15 N forward, 10 N to the left, and 3 N m
# about the vertical axis. `allocate` computes torques that change the independent
# velocities as this wrench would. If several torques do, it returns those of least
# norm. The **residual** is the part of the wrench that the wheels do not exert.

# %%
wanted = np.array([15.0, 10.0, 3.0])
print(f"{'':19} {'torques [N m]':28} residual (Fx, Fy, Mz) [N, N, N m]")
residuals = {}
for name, drive in able.items():
    at = drive.rest.copy()
    at[3 : 3 + len(drive.table.axes)] = angles.get(name, ())
    found = drive.allocate(at, wanted)
    residuals[name] = found.residual
    driven = found.u[np.abs(drive.input_matrix[-len(drive.table) :]).max(axis=0) > 0]
    assert np.allclose(wanted - wrenches(name) @ driven, found.residual, atol=1e-10)
    print(f"{name:19} {driven!s:28} {np.round(found.residual, 6) + 0.0}")

# %% [markdown]
# Mecanum and omni wheels leave no residual. The differential drive leaves the complete
# 10 N to the left. The wheels of the car and of the swerve modules have fixed steering
# angles here. These drives exert the force that accelerates them along their
# independent direction as the wrench would. The residual acts on the ground, which
# supports it.
#
# Four mecanum wheels have one torque more than the body has directions. So one pattern
# of torques moves nothing, because the wheels work against each other. The solution of
# least norm contains none of this pattern. If a motor reaches its limit, the residual
# contains the missing part of the wrench:

# %%
mecanum = drives["mecanum"]
fight = null_space(applied["mecanum"])[:, 0]
fight *= np.sign(fight[0]) / np.abs(fight).max()
start = np.zeros(mecanum.nv)
pushes = mecanum.allocate(mecanum.rest, wanted).u
with_it, without = (mecanum.forward_dynamics(mecanum.rest, start, u) for u in (pushes + fight, pushes))
print(f"torques that move nothing: {fight} N m on {', '.join(mecanum.table.names)}")
print(f"largest difference of the accelerations {np.abs(with_it - without).max():.0e}")
beyond = mecanum.allocate(mecanum.rest, 5 * wanted)
print(f"five times the wrench: torques {beyond.u} N m, residual {beyond.residual} N, N, N m")

# %% [markdown]
# ## The lecture's paths
#
# The lecture's robot of 30 kg now follows the lecture's paths on wheels. Computed
# torque stays unchanged if the drive can accelerate in every direction. On four mecanum
# wheels, the lecture's $\tau$ becomes the wheel torques of least norm. On a
# differential drive, no torques are the inverse of the dynamics. There a *kinematic
# law* first computes the $v$ and $\omega$ that lead back to the path,
#
# $$v = v_d \cos e_\psi + k_x e_x, \qquad
# \omega = \omega_d + \beta v_d \frac{\sin e_\psi}{e_\psi} e_y + k_x e_\psi, \qquad
# k_x = 2 \zeta \sqrt{\omega_d^2 + \beta v_d^2}$$
#
# with errors in body axes. Then **backstepping** computes the torques with which $\nu$
# follows $\nu_c = (v, \omega)$:
#
# $$\bar M (\dot\nu_c + k\,(\nu_c - \nu)) + \bar n = \bar B \tau .$$
#
# PD has no model of the wheels and commands the same force as before.
# `ControlAllocation` passes on the part that the wheels can exert. All runs are
# repeated from a start 0.1 m beside the path:

# %%
light = {"radius": 0.1, "mass": 0.2, "spin_inertia": 0.001, "yaw_inertia": 0.0005}
free = MobileRobot.lecture()
two = WheeledRobot(free, WheelTable.differential(0.3, supports=[(0.2, 0), (-0.2, 0)], **light))
four = WheeledRobot(free, WheelTable.mecanum(0.3, 0.3, **light))
via_stop = CubicVia((0, 0), (2, 2), (0, 4), t_via=30, t_end=60, via_velocity=(0, 0))
trajectories = {
    "via stop": Tangent(via_stop, turn_time=2),
    "via free": Tangent(CubicVia((0, 0), (2, 2), (0, 4), t_via=30, t_end=60)),
    "circle": Tangent(Circle(radius=3, rate=0.1, duration=60)),
}
pd = PD((120, 120, 0.4), (120, 120, 0.4))
rivals = {
    "free body, PD": (free, pd),
    "free body, computed torque": (free, ComputedTorque(free)),
    "mecanum, computed torque": (four, ComputedTorque(four)),
    "differential, backstepping": (two, Backstepping(UnicycleTracking(), two, k=4)),
    "differential, PD allocated": (two, ControlAllocation(pd, two)),
}


def distance(run):
    """Return the distance from the reference position, shape (samples,) [m]."""
    return np.linalg.norm(run.error[:, :2], axis=1)


runs, on_path, left_over = {}, {}, {}
print(f"{'distance from the reference':39} largest, start  at the end, start")
print(f"{'':39}     on the path  0.1 m beside path")
for path_name, trajectory in trajectories.items():
    for name, (plant, controller) in rivals.items():
        run = simulate(plant, controller, trajectory, dt=0.1, engine=Engine.COMPILED)
        q0 = run.q[0].copy()
        q0[:2] += 0.1 * np.array([-np.sin(q0[2]), np.cos(q0[2])])
        start = {"q0": q0, "v0": run.v[0]}
        beside = simulate(plant, controller, trajectory, dt=0.1, engine=Engine.COMPILED, **start)
        runs[path_name, name] = beside
        on_path[path_name, name] = distance(run).max()
        left_over[path_name, name] = distance(beside)[-1]
        largest, at_end = 1e3 * distance(run).max(), 1e3 * distance(beside)[-1]
        print(f"{path_name:9} {name:29} {largest:12.3f} mm {at_end:15.3f} mm")

# %%
shown = ("mecanum, computed torque", "differential, backstepping", "differential, PD allocated")
figure, (left, right) = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
for k, name in enumerate(shown):
    run, style = runs["circle", name], ("-", "--", ":")[k]
    early = run.t <= 12
    left.plot(*run.q[early, :2].T, style, color=colour(k), linewidth=2.2, label=name)
    right.semilogy(run.t, 1e3 * distance(run), style, color=colour(k), linewidth=2.2)
left.plot(*run.reference.q[early, :2].T, color=INK, linewidth=1, label="reference")
left.set(xlabel="x [m]", ylabel="y [m]", title="The first 12 s", aspect="equal")
left.legend(frameon=False)
right.set(xlabel="t [s]", ylabel="distance [mm]", title="Distance from the reference")
figure.suptitle("The circle, with a start 0.1 m beside it")
for axes in (left, right):
    dress(axes)

# %% [markdown]
# On the circle the wheels even improve PD. Constraint forces keep the robot on the
# curve. On the free body, PD needs an error to produce this force. But beside the path
# PD commands a force to the side, and the wheels cannot exert it. This force is the
# residual, and the robot stays beside the path. With mecanum wheels, computed torque
# returns to the path like on the free body. With the differential drive, backstepping
# steers back.
#
# ## Motions that the wheels cannot follow
#
# A differential drive cannot follow a path with a constant heading, because it would
# have to move sideways. It cannot follow a heading that jumps either. Computed torque
# is not defined for this drive. In all three cases the library raises an error before
# the robot moves:

# %%
messages = {}
sideways_path = FixedHeading(Circle(3, 0.1, 60), 0.0)
steering = Backstepping(UnicycleTracking(), two)
for name, attempt in {
    "constant heading": lambda: simulate(two, steering, sideways_path, dt=0.1),
    "heading with a jump": lambda: simulate(two, steering, LectureHeading(via_stop), dt=0.1),
    "computed torque": lambda: ComputedTorque(two),
}.items():
    try:
        attempt()
    except InvalidArgument as error:
        messages[name] = str(error)
        print(f"{name}: {error}\n")
sideways_run = simulate(four, ComputedTorque(four), sideways_path, dt=0.1, engine=Engine.COMPILED)
sideways_error = 1e3 * distance(sideways_run).max()
print(f"mecanum drive with constant heading: largest error {sideways_error:.3f} mm")

# %% [markdown]
# ## The claim
#
# - The model of a robot on rolling wheels is the lecture's model, projected on the
#   motions without slip.
# - The derivation by hand, the null space and the KKT equations agree.
# - The wheel table determines the wrenches that the motors can exert.
# - Computed torque needs wrenches in all three dimensions. On other drives,
#   backstepping returns to the path and PD does not.

# %%
assert ranks["differential"] == (5, 4, 3, 2, 0), "the differential drive has other ranks"
assert ranks["mecanum"] == (7, 4, 4, 3, 0), "the mecanum drive has other ranks"
assert ranks["three omni wheels"] == (6, 3, 3, 3, 0), "the omni drive has other ranks"
assert ranks["two swerve modules"] == (7, 4, 4, 1, 2), "the swerve drive has other ranks"
assert ranks["car"][3:] == (1, 1), "the car has another type"
printed = sympy.Matrix([-m * xbc * turn**2, m * xbc * speed * turn])
assert sympy.simplify(n_bar - printed) == sympy.zeros(2, 1), "n differs from the text"
assert sympy.simplify(M_bar[0, 0] - m - 2 * Iw / r**2) == 0, "the wheels add another mass"
assert max(differences.values()) < 1e-10, "the methods differ"
assert report.passed, "the library's methods differ"
assert list(reach.values()) == [2, 1, 2, 3, 3], "a set of wrenches has another dimension"
assert np.allclose(residuals["differential"], [0, 10, 0]), "another residual"
for name in ("mecanum", "three omni wheels"):
    assert np.abs(residuals[name]).max() < 1e-9, "a drive of mobility 3 has a residual"
assert np.abs(with_it - without).max() < 1e-10, "the pattern of torques moves the robot"
assert np.abs(beyond.u).max() <= 2, "a torque exceeds its limit"
assert np.abs(beyond.residual).max() > 1, "the limits leave no residual"
for path_name in trajectories:
    assert on_path[path_name, "mecanum, computed torque"] < 1e-4, "mecanum wheels deviate"
    returned = "mecanum, computed torque", "differential, backstepping"
    for name in returned:
        assert left_over[path_name, name] < 1e-4, f"no return to the path: {name}"
    assert left_over[path_name, "differential, PD allocated"] > 0.01, "PD returns"
lost = on_path["circle", "free body, PD"] / on_path["circle", "differential, PD allocated"]
assert lost > 10, "the wheels do not improve PD on the circle"
assert "sideways" in messages["constant heading"], "no error for a constant heading"
assert "heading" in messages["heading with a jump"], "no error for a jump"
assert "Backstepping" in messages["computed torque"], "no error for computed torque"
assert distance(sideways_run).max() < 1e-4, "the mecanum drive deviates sideways"
worst = max(differences["null space"], differences["KKT"])
ended = {law: left_over["circle", f"differential, {law}"] for law in ("backstepping", "PD allocated")}
print(
    f"Shown: the three methods agree within {worst:.0e}. From a start 0.1 m beside the circle, "
    f"backstepping ends {1e3 * ended['backstepping']:.2f} mm from the reference; PD on the "
    f"same wheels ends {1e3 * ended['PD allocated']:.2f} mm from it."
)
