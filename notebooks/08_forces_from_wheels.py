# %% [markdown]
# # 8 Forces from wheels: which drive can do what
#
# So far somebody pushed the body: $\tau = (F_x, F_y, M_z)$ came from nowhere. A robot on the ground has
# wheels, and these can do less: two of them on an axle give no force to the side. What remains of
# $M(q)\,\ddot q + n(q, \dot q) = \tau$ then? Which forces can which drive apply? And what becomes of the
# lecture's controllers and of the lecture's paths?
#
# Here the wheels roll and never slip, whatever force that takes. What happens when the ground cannot supply
# that force is the story of notebook 9.

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
# As the Denavit-Hartenberg table has one row per joint, the wheel table has one row per wheel: where it
# stands in the body's frame, its radius, where it rolls to, whether it is steered, whether it has rollers
# and at which angle, whether it has a motor. Two wheels on one axle and a caster behind:

# %%
wheels = WheelTable.differential(
    track=0.5, radius=0.1, supports=[(-0.3, 0)], mass=1.0, spin_inertia=0.005, yaw_inertia=0.003
)
print(wheels)

# %% [markdown]
# The last three lines follow from the rows alone. A tyre obeys two equations: where it touches the ground
# it moves neither along its direction nor across it. Written for all wheels they are $A(q)\,\dot q = 0$,
# now with $q = (x, y, \psi, \varphi_L, \varphi_R)$: the wheels' angles are coordinates too. How many of
# these rows are independent is the **rank**; what is left of the velocities is free. The **type** counts
# what the body alone may do (Campion, Bastin and d'Andrea-Novel, 1996): its *mobility* is the number of
# directions in which it can start at once, its *steerability* the number of steering angles that may be
# chosen. The same for other drives, all about as large:

# %%
own = {"radius": 0.1, "mass": 0.5, "spin_inertia": 0.0025, "yaw_inertia": 0.0013, "motor": Motor(2.0)}
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
print(f"{'':19} coordinates  rows  rank  free velocities  type    motors")
ranks = {}
for name, drive in drives.items():
    able = drive.mobility
    rows, columns = able.matrix.shape
    ranks[name] = columns, rows, able.rank, able.mobility, able.steerability
    free = columns - able.rank if able.is_regular else "none"
    numbers = f"{columns:11}  {rows:4}  {able.rank:4}  {free:>15}"
    print(f"{name:19} {numbers}  ({able.mobility}, {able.steerability})  {drive.nu:6}")
print(f"\nskid-steer {drives['skid-steer'].mobility.rolling_obstacle}.")

# %% [markdown]
# A drive of mobility 3 can start in any direction; of mobility 2 only straight on and about the vertical;
# the car's body has one free direction at each steering angle. The skid-steer base cannot roll at all,
# but straight on: it has its place in notebook 9.
#
# ## The equations of motion, step by step
#
# Take the lecture's way: symbols, one step at a time. Half the track is $b$, the radius $r$, the inertia
# of each wheel about its axle $I_w$. The mass $m$, the centre of mass $(x_{bc}, y_{bc})$ and $I_{cz}$ are
# those of the whole, and the origin of the body's frame lies in the middle of the axle. (In the output,
# a dot over a coordinate is its rate, $c_\psi = \cos\psi$ and $s_\psi = \sin\psi$.)

# %%
m, xbc, ybc, Icz, Iw, r, b = sympy.symbols("m x_bc y_bc I_cz I_w r b", positive=True)
x, y, psi, left, right = q = sympy.Matrix(sympy.symbols("x y psi varphi_L varphi_R", real=True))
rates = sympy.Matrix([sympy.Symbol(rf"\dot{{{sympy.latex(one)}}}", real=True) for one in q])
speed, turn = nu = sympy.Matrix(sympy.symbols("v omega", real=True))
tau = sympy.Matrix(sympy.symbols("tau_L tau_R", real=True))


def show(title, symbol, result, text=""):
    """Show a step: its title, a sentence, and the formula."""
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
    r"(s_{L,\mathrm{along}}, s_{L,\mathrm{across}}, s_{R,\mathrm{along}}, s_{R,\mathrm{across}})^T",
    sympy.Matrix(slip),
    "The body's velocity along its own axes, what its turning adds at $(0, \\pm b)$, less the rolling.",
)
A = sympy.Matrix(slip).jacobian(rates)
show("Constraint matrix", "A(q)", A, "What multiplies the rates. Rows two and four are the same: rank 3.")

# %% [markdown]
# Three independent equations for five rates: two of these may be chosen. The speed $v$ of the axle's
# middle and the yaw rate $\omega$ tell all others, $\dot q = S(q)\,\nu$ with $\nu = (v, \omega)$:

# %%
S = sympy.Matrix([[c, 0], [s, 0], [0, 1], [1 / r, -b / r], [1 / r, b / r]])
show("Null space", "S(q)", S, "Each column is a motion that rolls.")
assert sympy.simplify(A * S) == sympy.zeros(4, 2)
assert A.rank() == 3
print("A S = 0 holds for every heading")

# %% [markdown]
# The lecture's $M$ and $n$, derived in notebook 1, hold the whole with its wheels locked. A wheel that
# spins besides adds its inertia about the axle, and nothing else: it is a solid of revolution, so turning
# it changes no other mass. Its torque acts on its own angle alone:

# %%
lecture = derivation.lecture()
given = dict(zip(sympy.symbols("m xbc ybc Icz psi psidot"), (m, xbc, ybc, Icz, psi, rates[2]), strict=True))
named = {symbol: given[sympy.Symbol(symbol.name)] for symbol in lecture.mass_matrix.free_symbols}
named |= {one: given[sympy.Symbol(one.name)] for one in lecture.nonlinear_effects.free_symbols}
M = sympy.diag(lecture.mass_matrix.subs(named), Iw, Iw)
n = sympy.Matrix([*lecture.nonlinear_effects.subs(named), 0, 0])
B = sympy.Matrix([[0, 0], [0, 0], [0, 0], [1, 0], [0, 1]])
show("Mass matrix, wheels included", "M(q)", M)
show("Nonlinear effects", "n^T", n.T)

# %% [markdown]
# The ground holds the wheels by forces $\lambda$ along the rows of $A$. With these,
#
# $$M \ddot q + n = B\,\tau + A^T \lambda .$$
#
# Nobody knows $\lambda$ beforehand. But a force that keeps wheels from slipping does no work on a motion
# that does not slip: $S^T A^T = 0$. So put in $\ddot q = S \dot\nu + \dot S \nu$, multiply by $S^T$ from
# the left, and the forces are gone:
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
show("Reduced nonlinear effects", r"\bar n", n_bar, "They vanish where the centre of mass is on the axle.")
show("Reduced input matrix", r"\bar B", B_bar, "Both torques push, their difference turns.")

# %% [markdown]
# Two equations in place of five, and they can be read. A wheel's inertia counts as the mass $I_w / r^2$.
# A centre of mass ahead of the axle is flung forward by turning ($-m\,x_{bc}\,\omega^2$), and a robot that
# turns while it drives is turned back by it ($m\,x_{bc}\,v\,\omega$): ahead of the axle the mass keeps it
# straight, behind the axle it makes it spin.
#
# What do the wheels carry? Along, each wheel's own equation tells. Across, there is one equation for two
# wheels, since two rows of $A$ are the same: it tells their sum. How left and right share it cannot be
# known of rigid wheels.

# %%
nu_rate = sympy.Matrix(sympy.symbols(r"\dot{v} \dot{\omega}", real=True))
unknown = B * tau - M * (S * nu_rate + S_dot * nu) - n.subs(rolls)  # it is -A' lambda
along = [sympy.expand(unknown[3 + k] / r) for k in range(2)]
sideways = sympy.simplify(-(-s * unknown[0] + c * unknown[1]))
show("Force along a wheel, left and right", r"(\lambda_L, \lambda_R)", sympy.Matrix([along]))
show("Force across the axle, left and right together", "Y", sympy.expand(sideways))

# %% [markdown]
# ## Three routes, once more
#
# By hand: the two equations above, in the library `closed_form.differential_drive`. By null space: a basis
# of what $A$ leaves, found numerically, for $M$, $n$ and $A$ from Pinocchio's tree of bodies. And without
# any elimination: all accelerations and all forces of the ground at once, from
#
# $$\begin{pmatrix} M & A^T \\ A & 0 \end{pmatrix}
# \begin{pmatrix} \ddot q \\ -\lambda \end{pmatrix} =
# \begin{pmatrix} B \tau - n \\ -\dot A \dot q \end{pmatrix}$$
#
# (the conditions of Karush, Kuhn and Tucker for Gauss's principle of least constraint: KKT). At 200 random
# states and torques:

# %%
robot = WheeledRobot(body, wheels)
numbers = {m: 30.0, xbc: 0.1, ybc: 0.05, Icz: 1.3, Iw: 0.005, r: 0.1, b: 0.25}
symbolic = sympy.lambdify(list(nu), [one.subs(numbers) for one in (M_bar, n_bar)])
forces = sympy.lambdify([*nu, *nu_rate, *tau], [one.subs(numbers) for one in (*along, sideways)])
generator = np.random.default_rng(0)
far = {"printed above": 0.0, "null space": 0.0, "KKT": 0.0, "forces": 0.0}
for _ in range(200):
    where = np.append(generator.uniform(-3, 3, 3), generator.uniform(-9, 9, 2))
    going, torques = generator.uniform(-2, 2, 2), generator.uniform(-5, 5, 2)
    rolling = robot.reduced(where, np.zeros(5)).S @ going
    hand = closed_form.differential_drive(
        going, mass=30.0, yaw_inertia=1.3, com=(0.1, 0.05), track=0.5, radius=0.1, spin_inertia=0.005
    )
    by_hand = np.linalg.solve(hand.M, hand.B @ torques - hand.n)
    printed = symbolic(*going)
    far["printed above"] = max(
        far["printed above"], np.abs(printed[0] - hand.M).max(), np.abs(printed[1][:, 0] - hand.n).max()
    )
    matrices = robot.mass_matrix(where), robot.nonlinear_effects(where, rolling)
    rows, drift = robot.constraint_matrix(where), robot.constraint_drift(where, rolling)
    pushed = robot.input_matrix @ torques - matrices[1]
    basis = null_space(rows)
    kept = -np.linalg.pinv(rows) @ drift
    reduced = basis.T @ matrices[0] @ basis
    by_space = basis @ np.linalg.solve(reduced, basis.T @ (pushed - matrices[0] @ kept)) + kept
    whole = np.block([[matrices[0], rows.T], [rows, np.zeros((4, 4))]])
    found = np.linalg.lstsq(whole, np.concatenate([pushed, -drift]), rcond=1e-12)[0]
    heading = np.array([np.cos(where[2]), np.sin(where[2])])
    for name, a in (("null space", by_space), ("KKT", found[:5])):
        far[name] = max(far[name], abs(heading @ a[:2] - by_hand[0]), abs(a[2] - by_hand[1]))
    told = forces(*going, *by_hand, *torques)
    solved = -found[5:]
    here = [solved[0] - told[0], solved[2] - told[1], solved[1] + solved[3] - told[2]]
    far["forces"] = max(far["forces"], np.abs(here).max())
for name, unit in zip(far, ("kg m^2, N m", "m/s^2, rad/s^2", "m/s^2, rad/s^2", "N"), strict=True):
    print(f"by hand beside {name:14} largest difference {far[name]:.0e} {unit}")

# %% [markdown]
# The library keeps such a table for every drive, with more routes:

# %%
report = verify(robot)
print(report)

# %% [markdown]
# ## Which forces can a drive apply?
#
# Give each motor at most 2 N m. A wheel of radius $r$ without rollers pushes along itself with up to
# $2\,\mathrm{N\,m} / r = 20$ N. Where there are rollers, the ground can only push along the axis of the one
# that touches it, since it spins about that freely. Summed up over the wheels: $\tau_{\mathrm{body}} = J^T
# \tau_{\mathrm{wheels}}$, the transpose of the $J$ that gives the wheels' rates from the body's velocity.

# %%
angles = {"car": [0.4], "two swerve modules": [0.5, -0.3]}  # [rad]
able = {name: drive for name, drive in drives.items() if name != "skid-steer"}


def wrenches(name):
    """Return what each motor of a drive exerts on the body per torque, shape (3, motors)."""
    drive, steering = able[name], angles.get(name, ())
    J = drive.wheel_rates(np.eye(3), np.tile(steering, (3, 1)) if steering else ())
    turned = drive.input_matrix[-len(drive.table) :]
    return J @ turned[:, np.abs(turned).max(axis=0) > 0]


def draw_from_above(axes, name):
    """Draw the wheels, and arrows along which the ground pushes them."""
    table, steering = able[name].table, dict(enumerate(angles.get(name, ())))
    turned = {row: steering[k] for k, axis in enumerate(table.axes) for row in axis.wheels}
    driven = able[name].input_matrix[-len(table) :].any(axis=1)
    for row, wheel in enumerate(table.wheels):
        angle = wheel.angle + turned.get(row, 0.0)
        along = angle + (wheel.roller or 0.0)
        about = {"angle": np.degrees(angle), "rotation_point": (wheel.x, wheel.y)}
        axes.add_patch(Rectangle((wheel.x - 0.1, wheel.y - 0.03), 0.2, 0.06, **about, color="#c8ccd0"))
        if driven[row]:
            tip = wheel.x + 0.2 * np.cos(along), wheel.y + 0.2 * np.sin(along)
            arrow = {"arrowstyle": "-|>", "color": colour(1), "linewidth": 1.8}
            axes.annotate("", tip, (wheel.x, wheel.y), arrowprops=arrow)
    axes.plot(0, 0, "+", color=INK)
    middle = np.mean([wheel.x for wheel in table.wheels])
    axes.set(xlim=(middle - 0.55, middle + 0.55), ylim=(-0.55, 0.55), aspect="equal", xlabel="x [m]")
    axes.set_title(name, fontsize=11)


def draw_reach(axes, W, rows):
    """Draw what torques of up to 2 N m reach in two of the wrench's components."""
    corners = np.array([W @ torques for torques in product((-2.0, 2.0), repeat=W.shape[1])])[:, rows]
    if np.linalg.matrix_rank(corners, tol=1e-9) == 2:
        edge = corners[ConvexHull(corners).vertices]
        axes.add_patch(Polygon(edge, facecolor=tint(colour(0), 0.25), edgecolor=colour(0), linewidth=1.8))
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
figure.suptitle("Drives from above, where the ground pushes their driven wheels, and what that adds up to")
reach = {name: np.linalg.matrix_rank(W, tol=1e-9) for name, W in applied.items()}
print("dimensions of what motors can apply:", ", ".join(f"{name} {k}" for name, k in reach.items()))

# %% [markdown]
# In blue is what motors can do. The differential drive has a line in the upper plot: no force to the side.
# The car has a line in both: one force along the rear axle's normal. Mecanum and omni wheels fill all
# three dimensions. Forward, a motor of a mecanum wheel gives the same 20 N as one of a tyre; it is the
# direction that is gained. (The ground does push a car's front wheels to
# the side, and turns it so. But nobody commands these forces: they are the $\lambda$ that rolling asks for.)
#
# ## Allocation, and what it leaves
#
# Now ask each drive for the same: 15 N forward, 10 N to the left, 3 N m about the vertical. `allocate`
# finds the torques that come nearest, of least norm where there are several, and the **residual**: what
# of the wrench the wheels do not supply.

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
# Mecanum and omni wheels leave nothing. The differential drive leaves the 10 N to the left, whole. The
# car and the swerve modules, whose wheels stand where they stand, supply what moves them as the wrench would
# along the direction that is free to them, and leave the rest to the ground, which carries it.
#
# Four mecanum wheels have one torque more than there are directions. There is a pattern that makes them
# fight each other and moves nothing; of all solutions the one of least norm has none of it. And where a
# motor is at its limit, the residual tells what is lost:

# %%
mecanum = drives["mecanum"]
fight = null_space(applied["mecanum"])[:, 0]
fight *= np.sign(fight[0]) / np.abs(fight).max()
start = np.zeros(mecanum.nv)
pushes = mecanum.allocate(mecanum.rest, wanted).u
with_it, without = (mecanum.forward_dynamics(mecanum.rest, start, u) for u in (pushes + fight, pushes))
print(f"torques that move nothing: {fight} N m on {', '.join(mecanum.table.names)}")
print(f"accelerations differ by {np.abs(with_it - without).max():.0e}")
beyond = mecanum.allocate(mecanum.rest, 5 * wanted)
print(f"five times the wrench: torques {beyond.u} N m, residual {beyond.residual}")

# %% [markdown]
# ## The lecture's paths
#
# The lecture's robot of 30 kg drives the lecture's paths, on wheels. Computed torque stays what it was
# where the drive can accelerate in every direction: $\tau$ of the lecture becomes the torques of least norm
# at four mecanum wheels. On a differential drive no torques are the inverse of the dynamics. There, a
# *kinematic law* first says which $v$ and $\omega$ lead back to the path,
#
# $$v = v_d \cos e_\psi + k_x e_x, \qquad
# \omega = \omega_d + \beta v_d \frac{\sin e_\psi}{e_\psi} e_y + k_x e_\psi, \qquad
# k_x = 2 \zeta \sqrt{\omega_d^2 + \beta v_d^2}$$
#
# (errors along the robot's own axes), and **backstepping** finds the torques with which $\nu$ follows it:
# $\bar M (\dot\nu_c + k\,(\nu_c - \nu)) + \bar n = \bar B \tau$. And PD? It does not know about wheels and
# asks for what it always asks for; `ControlAllocation` passes on what wheels can supply of it. The same runs
# once
# more from a start 0.1 m beside the path:

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
    """Return the distance from where the robot should be, shape (samples,) [m]."""
    return np.linalg.norm(run.error[:, :2], axis=1)


runs, on_path, left_over = {}, {}, {}
print(f"{'':38}  on the path: largest   0.1 m beside: left at the end")
for path_name, trajectory in trajectories.items():
    for name, (plant, controller) in rivals.items():
        run = simulate(plant, controller, trajectory, dt=0.1, engine=Engine.COMPILED)
        q0 = run.q[0].copy()
        q0[:2] += 0.1 * np.array([-np.sin(q0[2]), np.cos(q0[2])])
        beside = simulate(plant, controller, trajectory, dt=0.1, q0=q0, v0=run.v[0], engine=Engine.COMPILED)
        runs[path_name, name] = beside
        on_path[path_name, name] = distance(run).max()
        left_over[path_name, name] = distance(beside)[-1]
        numbers = f"{1e3 * on_path[path_name, name]:14.3f} mm {1e3 * left_over[path_name, name]:25.3f} mm"
        print(f"{path_name:9} {name:27} {numbers}")

# %%
shown = ("mecanum, computed torque", "differential, backstepping", "differential, PD allocated")
figure, (left, right) = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
for k, name in enumerate(shown):
    run, style = runs["circle", name], ("-", "--", ":")[k]
    early = run.t <= 12
    left.plot(*run.q[early, :2].T, style, color=colour(k), linewidth=2.2, label=name)
    right.semilogy(run.t, 1e3 * distance(run), style, color=colour(k), linewidth=2.2)
left.plot(*run.reference.q[early, :2].T, color=INK, linewidth=1, label="desired")
left.set(xlabel="x [m]", ylabel="y [m]", title="The first 12 s", aspect="equal")
left.legend(frameon=False)
right.set(xlabel="t [s]", ylabel="distance [mm]", title="Distance from where it should be")
figure.suptitle("The circle, begun 0.1 m beside it")
for axes in (left, right):
    dress(axes)

# %% [markdown]
# On the circle the wheels even help PD: they carry the force that the curve takes, which on the free body
# PD makes of an error. But beside the path PD calls for a force to the side and does not get it. That is
# the residual, and the robot stays beside. Mecanum wheels bring it back as if there were none, and
# backstepping steers back.
#
# ## What the wheels cannot follow
#
# A path with a heading that stays, say, is no motion of a differential drive: it would have to go sideways.
# Computed torque does not fit it at all. Both are refused before anything moves, with words:

# %%
words = {}
for name, attempt in {
    "sideways": lambda: simulate(
        two, Backstepping(UnicycleTracking(), two), FixedHeading(Circle(3, 0.1, 60), 0.0), dt=0.1
    ),
    "a heading that jumps": lambda: simulate(
        two, Backstepping(UnicycleTracking(), two), LectureHeading(via_stop), dt=0.1
    ),
    "no inverse dynamics": lambda: ComputedTorque(two),
}.items():
    try:
        attempt()
    except InvalidArgument as error:
        words[name] = str(error)
        print(f"{name}: {error}\n")
sideways_run = simulate(
    four, ComputedTorque(four), FixedHeading(Circle(3, 0.1, 60), 0.0), dt=0.1, engine=Engine.COMPILED
)
print(f"the mecanum drive follows it sideways, {1e3 * distance(sideways_run).max():.3f} mm off at most")

# %% [markdown]
# ## The claim
#
# The model of a robot on wheels that roll is the lecture's, projected on the motions that roll; derived by
# hand, by null space and with all forces at once it is the same. Which wrenches motors can apply follows
# from the table; computed torque needs all of them, and where they are not there, backstepping gets back to
# the path and PD does not.

# %%
assert ranks["differential"] == (5, 4, 3, 2, 0), "the differential drive has other ranks"
assert ranks["mecanum"] == (7, 4, 4, 3, 0), "the mecanum drive has other ranks"
assert ranks["three omni wheels"] == (6, 3, 3, 3, 0), "the omni drive has other ranks"
assert ranks["two swerve modules"] == (7, 4, 4, 1, 2), "the swerve drive has other ranks"
assert ranks["car"][3:] == (1, 1), "the car is of another type"
assert sympy.simplify(n_bar - sympy.Matrix([-m * xbc * turn**2, m * xbc * speed * turn])) == sympy.zeros(2, 1)
assert sympy.simplify(M_bar[0, 0] - m - 2 * Iw / r**2) == 0, "wheels count as another mass"
assert max(far.values()) < 1e-10, "the routes differ"
assert report.passed, "the library's routes differ"
assert list(reach.values()) == [2, 1, 2, 3, 3], "motors can apply something else"
assert np.allclose(residuals["differential"], [0, 10, 0]), "the differential drive leaves something else"
for name in ("mecanum", "three omni wheels"):
    assert np.abs(residuals[name]).max() < 1e-9, "a drive of mobility 3 leaves something"
assert np.abs(with_it - without).max() < 1e-10, "the fight moves something"
assert np.abs(beyond.u).max() <= 2, "a limit is exceeded"
assert np.abs(beyond.residual).max() > 1, "limits cost nothing"
for path_name in trajectories:
    assert on_path[path_name, "mecanum, computed torque"] < 1e-4, "mecanum wheels err"
    assert left_over[path_name, "mecanum, computed torque"] < 1e-4, "mecanum wheels do not come back"
    assert left_over[path_name, "differential, backstepping"] < 1e-4, "backstepping does not come back"
    assert left_over[path_name, "differential, PD allocated"] > 0.01, "PD comes back"
lost = on_path["circle", "free body, PD"] / on_path["circle", "differential, PD allocated"]
assert lost > 10, "the wheels do not carry the curve"
assert "sideways" in words["sideways"], "sideways is not refused"
assert "heading" in words["a heading that jumps"], "a jump is not refused"
assert "Backstepping" in words["no inverse dynamics"], "computed torque is not refused"
assert distance(sideways_run).max() < 1e-4, "the mecanum drive errs sideways"
worst = max(far["null space"], far["KKT"])
print(
    f"Shown: by hand, by null space and by KKT within {worst:.0e}; begun 0.1 m beside the circle, "
    f"backstepping ends within {1e3 * left_over['circle', 'differential, backstepping']:.2f} mm, PD on the "
    f"same wheels stays {1e3 * left_over['circle', 'differential, PD allocated']:.0f} mm beside."
)
