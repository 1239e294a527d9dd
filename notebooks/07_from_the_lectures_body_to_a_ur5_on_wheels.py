# %% [markdown]
# # 7 From the lecture's body to a UR5 on wheels
#
# The lecture models a mobile robot as one would a manipulator: a chain of joints, and a body at its end.
# So nothing keeps us from going on: three joints in the plane, the body, and behind it the six joints of
# a UR5. The equation stays the same,
#
# $$M(q)\,\ddot q + n(q, \dot q) = \tau, \qquad q = (x, y, \psi, \theta_1, \dots, \theta_6),$$
#
# with $M$ now $9 \times 9$. Where is the lecture's $3 \times 3$ in it? How far does the derivation by hand
# go? What does it cost to control base and arm as if they were two robots? And how heavy may what the arm
# holds be before the base must slow down?

# %%
import matplotlib.pyplot as plt
import numpy as np
import pinocchio as pin
import sympy

from pinmobile import (
    Circle,
    ComputedTorque,
    CubicVia,
    EndEffectorTracking,
    MobileRobot,
    Normal,
    PayloadBody,
    PosePath,
    RestToRest,
    SameAs,
    Tangent,
    Uniform,
    WholeBody,
    clearance,
    closed_form,
    derivation,
    ensemble,
    plots,
    rk4,
    simulate,
    solve_inverse_kinematics,
)
from pinmobile.balance import reaction_wrench, required_friction, tip_over_margin
from pinmobile.controllers import Decoupled
from pinmobile.dh import LECTURE_TABLE, DHRow, DHTable, JointType
from pinmobile.errors import Unreachable
from pinmobile.plots.style import INK, colour, dress, line_style, tint

np.set_printoptions(precision=3, suppress=True, linewidth=110)

# %% [markdown]
# ## One call
#
# The body is a homogeneous box of 30 kg; the UR5 stands on its top, a little off the middle.

# %%
base = MobileRobot.box(30)
robot = base.mount("ur5", at=(0.1, -0.05, 0.2, 0.4))
posture = np.array([0, -1.2, 1.4, -0.2, 0.6, 0])
q = np.concatenate([[1, 2, 0.7], posture])
print(f"{robot.nv} coordinates: {', '.join(one.name for one in robot.coordinates)}\n")
print(f"M(q) of the body alone:\n{base.mass_matrix(q[:3])}")
print(f"M(q) of body and arm:\n{robot.mass_matrix(q)}")

# %% [markdown]
# The upper left block is the base's, the lower right one the arm's; what is beside them couples the two:
# a joint that accelerates pushes the base, and the other way round.
#
# ## The lecture's matrix in it
#
# With all joints of the arm locked, body and arm are one rigid body. The upper left block must therefore
# be the lecture's closed form, with the mass, the centre of mass and the yaw inertia of the whole at this
# posture:

# %%
generator = np.random.default_rng(0)
samples = robot.random_configuration(generator, (100,))
largest = 0.0
for sample in samples:
    whole = robot.lumped(sample)
    by_hand = closed_form.mass_matrix(
        sample[:3], mass=whole.mass, yaw_inertia=whole.yaw_inertia, com=whole.com[:2]
    )
    largest = max(largest, np.abs(robot.mass_matrix(sample)[:3, :3] - by_hand).max())
print(f"largest difference at {len(samples)} random postures: {largest:.1e}")

stretch = np.linspace(0, 1, 50)
lumps = [robot.lumped(share * np.array([0, -0.2, 0.1, 0, 0, 0]) + (1 - share) * posture) for share in stretch]
figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3), layout="constrained")
left.plot(100 * stretch, [whole.yaw_inertia for whole in lumps], color=colour(0))
left.set(xlabel="arm stretched out [%]", ylabel="yaw inertia of the whole [kg m²]")
right.plot(100 * stretch, [np.hypot(*whole.com[:2]) for whole in lumps], color=colour(1))
right.set(xlabel="arm stretched out [%]", ylabel="centre of mass off the axis [m]")
for axes in (left, right):
    dress(axes)

# %% [markdown]
# What was constant for the lecture's body, $I_{cz}$ and $(x_{bc}, y_{bc})$, now depends on the posture.
#
# ## The arm fades
#
# Let all masses and inertias of the arm shrink by a factor $s$. What is left of the block above the
# lecture's matrix must shrink as $s$ does:

# %%
ARM = robot.mounts[0].model


def faded(share):
    """Return the base with an arm that has this share of its masses and inertias."""
    model = ARM.copy()
    for joint, inertia in enumerate(ARM.inertias):
        model.inertias[joint] = pin.Inertia(share * inertia.mass, inertia.lever, share * inertia.inertia)
    return base.mount(model, at=(0.1, -0.05, 0.2, 0.4), name="ur5")


shares = 10.0 ** -np.arange(0, 9)
lectures = base.mass_matrix(q[:3])
rest_of_it = np.array([np.abs(faded(s).mass_matrix(q)[:3, :3] - lectures).max() for s in shares])
figure, axes = plt.subplots(figsize=(6, 3), layout="constrained")
axes.loglog(shares, rest_of_it, "o-", color=colour(0))
axes.set(xlabel="share of the arm's inertia", ylabel="largest difference [SI]")
axes.set_title("M[:3, :3] becomes the lecture's, in proportion")
dress(axes)

# %% [markdown]
# ## Where the derivation by hand ends
#
# The lecture's recursion does not know how many joints there are. `derivation` takes any table, so let us
# put the UR5's six rows behind the lecture's three, and count the operations in $M(q)$: written out, as
# one would on paper, and in named intermediate results, as a recursion computes them.

# %%
UR5_ROWS = (
    (0, 0, 0, 0.0892),
    (np.pi / 2, 0, 0, 0),
    (0, -0.425, 0, 0),
    (0, -0.392, 0, 0.109),
    (np.pi / 2, 0, 0, 0.0947),
    (-np.pi / 2, 0, 0, 0.0823),
)
m, xbc, ybc, Icz, g = sympy.symbols("m xbc ybc Icz g")
BODY = derivation.Link(m, (xbc, ybc, 0), sympy.diag(0, 0, Icz))


def derived(joints):
    """Return the derivation for the body with the first joints of the arm behind it."""
    rows = [DHRow(*row, JointType.REVOLUTE, f"theta{k}") for k, row in enumerate(UR5_ROWS[:joints], start=1)]
    links = (None, None, BODY, *(derivation.Link.general(k) for k in range(1, joints + 1)))
    return derivation.derive(DHTable((*LECTURE_TABLE, *rows)), links, gravity=(0, 0, -g))


def operations(derived):
    """Return the operations in M: every name once, and every name written out wherever it stands."""
    named, written = 0, {}

    def cost(expression):
        if expression.is_Atom:
            return written.get(expression, 0)
        return expression.count_ops() + inside(expression)

    def inside(expression):
        parts = expression.args
        return sum(written.get(part, 0) if part.is_Atom else inside(part) for part in parts)

    for name, expression in derived.assignments:
        written[name] = cost(expression)
        named += expression.count_ops()
    entries = list(derived.mass_matrix)
    return named + sum(entry.count_ops() for entry in entries), sum(cost(entry) for entry in entries)


numbers = (0, 1, 2, 4, 6)  # joints
counted = np.array([operations(derived(joints)) for joints in numbers])
for joints, (named, written) in zip(numbers, counted, strict=True):
    print(f"{joints} joints on the body: {named:6,} operations in steps, {written:12,} written out")

figure, axes = plt.subplots(figsize=(6, 3), layout="constrained")
for k, name in enumerate(("in named steps", "written out")):
    axes.semilogy(numbers, counted[:, k], "o-", color=colour(k), label=name)
axes.set(xlabel="joints of the arm on the body", ylabel="operations in $M(q)$")
axes.legend()
dress(axes)

# %% [markdown]
# The lecture's matrix has a line or two per entry; with one joint on it the paper is full; the UR5's would
# fill a book. In steps the same is a few thousand operations: not to be read any more, but to be computed.
# That is where the derivation by hand ends, and the recursion goes on: it is the one that Pinocchio runs,
# with numbers from the start.
#
# ## What the coupling costs
#
# The base drives a circle of 1 m at 0.5 rad/s, and every joint goes 0.5 rad and back within 6 s. Computed
# torque knows $M$ and $n$ of the whole. The decoupled controller has two models: a base with the arm as a
# load that is locked where it is, and an arm on a base that stands still. Each is right by itself. The
# plant is integrated by `rk4`: the lecture's step, the default, holds the acceleration over a sample, which
# is just what computed torque asks for, and so hides what holding the force costs.

# %%
motion = WholeBody(
    robot, Tangent(Circle(1, 0.5, 6)), CubicVia(posture, posture + 0.5, posture, t_via=3, t_end=6)
)
runs = {
    "computed torque": simulate(robot, ComputedTorque(robot, 100, 20), motion, dt=0.001, integrator=rk4),
    "decoupled": simulate(robot, Decoupled(robot, 100, 20), motion, dt=0.001, integrator=rk4),
}
for name, run in runs.items():
    print(f"--- {name}\n{run}\n")
plots.errors(runs, title="What the coupling costs; each panel has its own scale")

# %% [markdown]
# The model of the whole leaves what holding the force for 1 ms costs: micrometres, and below 0.1 mrad.
# Without the coupling, the same gains leave tenths of a millimetre and milliradians. The rule of
# [notebook 6](06_how_wrong_may_the_model_be.ipynb) tells why: the error is about $M^{-1}$ times the force
# that the model does not know of, divided by $k_p$.
#
# ## What the base feels
#
# The arm pushes on its foot; the ground has to carry all of it. Where the zero-moment point comes to the
# edge of the footprint, the robot tips over. The same motion six times as fast:

# %%
hurried = WholeBody(
    robot, Tangent(Circle(1, 3, 1)), CubicVia(posture, posture + 0.5, posture, t_via=0.5, t_end=1)
)
fast = simulate(robot, ComputedTorque(robot, 100, 20), hurried, dt=0.001, integrator=rk4)
for name, run in {"6 s": runs["computed torque"], "1 s": fast}.items():
    push = np.linalg.norm(reaction_wrench(run)[:, :2], axis=1).max()
    print(
        f"in {name}: the arm pushes the base by up to {push:5.1f} N; "
        f"tip-over margin {tip_over_margin(run).min():6.3f} m, friction {required_friction(run).max():.3f}"
    )
plots.balance(fast, title="In 1 s: balance on the ground")

# %% [markdown]
# ## The hand goes through poses, base and arm follow
#
# Nine coordinates, and a pose needs six: three are left. `PosePath.through` makes a smooth path of poses and
# times, here a way of 1.2 m on which the hand turns three quarters about its own axis;
# `solve_inverse_kinematics` finds, step
# by step and within the limits of the joints, how base and arm go together; the controller follows the pose
# itself, and what the pose leaves free follows the reference.

# %%
start = np.concatenate([np.zeros(3), posture])
held = robot.frame_pose(start)
poses = np.tile(held, (4, 1, 1))
poses[:, :3, 3] += [(0, 0, 0), (0.4, 0.2, 0.1), (0.8, 0.2, -0.1), (1.2, 0, 0)]
quarter = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]])
for k in range(4):
    poses[k, :3, :3] = held[:3, :3] @ np.linalg.matrix_power(quarter, k)
target = PosePath.through(poses, times=[0, 2, 4, 6])
way = solve_inverse_kinematics(robot, target, q0=start)
reached = simulate(robot, EndEffectorTracking(robot, target, dt=0.01), way, dt=0.01)
metres, radians = reached.end_effector().max_error()
travelled = np.ptp(reached.q[:, :2], axis=0)
print(f"the base goes {100 * travelled[0]:.0f} cm ahead and {100 * travelled[1]:.0f} cm aside,")
print(f"the hand strays by up to {1e6 * metres:.0f} µm and {1e6 * radians:.0f} µrad")
plots.end_effector(reached, title="The hand goes through four poses, base and arm follow")

# %% [markdown]
# Whether it goes through itself is another question. `clearance` asks the collision shapes, meshes of the
# UR5's file and the box; neighbours and what can never touch do not count, and it says which. A goal
# inside
# the robot's own body is reached to a hundredth of a millimetre; asked for a clearance,
# `solve_inverse_kinematics` refuses:

# %%
print(clearance(robot, reached.q).told)
into_itself = PosePath(RestToRest(held[:3, 3], (0.2, 0.15, 0.12), 4))
standing = np.where(np.arange(9) < 3, 0, robot.velocity_limit)
through = solve_inverse_kinematics(robot, into_itself, q0=start, velocity_limit=standing)
print(f"error {1e3 * through.max_error()[0]:.3f} mm, clearance {through.clearance.told}")
try:
    solve_inverse_kinematics(robot, into_itself, q0=start, velocity_limit=standing, clearance=0.01)
except Unreachable as refused:
    print(f"refused: {refused}")

# %% [markdown]
# ## How heavy may the payload be before the base must slow down?
#
# The base drives the lecture's circle, radius 3 m, at the lecture's 0.3 m/s and at up to nine times that.
# The arm is stretched out, holds a payload, and swings it from one side to the other and back in 6 s. Ten
# thousand robots hold payloads of 0 to 12 kg. Each has weighed its own, so that the controller knows the
# mass; but not where its centre of mass is: 10 cm ahead of the tool, it believes, give or take 3 cm, and 2
# cm to the sides. The same ten thousand drive at each of five speeds. Three things must not be: a hand
# more than 1 cm from where it should be, a joint that needs more torque than it has, a robot on the point
# of tipping over.

# %%
carrier = robot.attach(PayloadBody(2, com=(0, 0, 0.1), size=(0.1, 0.1, 0.1)))
stretched, swing = np.array([0, -0.6, 0.9, -0.3, 0.6, 0]), np.array([1.6, 0, 0, 0, 0, 0])
sideways = CubicVia(stretched - swing, stretched + swing, stretched - swing, t_via=3, t_end=6)
payloads = {
    "loads.0.mass": Uniform(0, 12),
    "controller.loads.0.mass": SameAs("loads.0.mass"),
    "loads.0.com.x": Normal(0, 0.02),
    "loads.0.com.y": Normal(0, 0.02),
    "loads.0.com.z": Normal(0.1, 0.03),
}
speeds = np.array([0.3, 0.9, 1.5, 2.1, 2.7])  # [m/s]
fleets = [
    ensemble(
        carrier,
        ComputedTorque(carrier, 100, 20),
        WholeBody(carrier, Tangent(Circle(3, speed / 3, 6)), sideways),
        n=10_000,
        spread=payloads,
        dt=0.02,
    )
    for speed in speeds
]
limits = {"end effector": 0.01, "effort": 1.0, "tip-over margin": 0.0}  # m, share, m
payload, edges = fleets[0].draws["loads.0.mass"], np.arange(0, 12.5, 0.5)
bins, middles = np.digitize(payload, edges) - 1, edges[:-1] + 0.25


def within(fleet, name):
    """Return which robots stay within a limit."""
    found = fleet.largest(name)
    return found >= limits[name] if "margin" in name else found <= limits[name]


def share_of(fine):
    """Return the share of the robots in each bin of payloads that are fine [%]."""
    return np.array([100 * fine[bins == k].mean() for k in range(len(middles))])


def heaviest(fine):
    """Return up to which payload 99 of 100 robots are fine [kg]."""
    few = share_of(fine) < 99
    return edges[few.argmax()] if few.any() else edges[-1]


fine = [np.all([within(fleet, name) for name in limits], axis=0) for fleet in fleets]
print("up to which payload 99 of 100 robots stay within, in kg")
print(f"{'speed':>8}  {'all limits':>10}  {'  '.join(limits)}")
for speed, fleet, good in zip(speeds, fleets, fine, strict=True):
    alone = "  ".join(f"{heaviest(within(fleet, name)):{len(name)}.1f}" for name in limits)
    print(f"{speed:4} m/s  {heaviest(good):10.1f}  {alone}")

# %%
figure, (left, right) = plt.subplots(1, 2, figsize=(10, 3.8), layout="constrained")
for k, (speed, good) in enumerate(zip(speeds, fine, strict=True)):
    left.plot(middles, share_of(good), **line_style(k, len(speeds)), label=f"{speed} m/s")
left.set(xlabel="payload [kg]", ylabel="robots within all limits [%]")
left.legend(title="speed of the base", loc="center right", frameon=False, handlelength=3.5)
words = {
    "end effector": ("the hand is where it should be", "o:", 6),
    "effort": ("the joints are strong enough", "s--", -14),
    "tip-over margin": ("the robot does not tip over", "^-", 7),
}
for name, (said, style, above) in words.items():
    bounds = [heaviest(within(fleet, name)) for fleet in fleets]
    right.plot(speeds, bounds, style, color=INK, markersize=7)
    right.annotate(said, (speeds[0], bounds[0]), xytext=(8, above), textcoords="offset points")
right.fill_between(speeds, [heaviest(good) for good in fine], color=tint(colour(0), 0.25))
right.set(xlabel="speed of the base [m/s]", ylabel="heaviest payload for 99 of 100 [kg]", ylim=(0, 12))
for axes in (left, right):
    dress(axes)

# %% [markdown]
# Shaded is what is safe. Neither hand nor joints care much for the speed: the hand errs because the
# controller puts the payload's weight in the wrong place, and the joints carry it, at 0.3 m/s as at 2.7.
# The robot tips over first, and there the speed counts: up to 7 kg it may do 0.3 m/s, up to 6 kg 0.9, up
# to 5 kg 1.5, up to 4 kg 2.1, up to 2 kg 2.7. Beyond 7 kg no speed helps: swung to the side, the payload
# tips even a base that hardly moves.
#
# With pencil and paper: on a circle of radius $r$ at speed $v$, a centre of mass at height $h$ pushes
# outwards with $m v^2 / r$, and moves the zero-moment point by $h v^2 / (r g)$.

# %%
h = carrier.lumped(np.concatenate([np.zeros(3), stretched])).com[2]
margins = [np.median(fleet.largest("tip-over margin")[np.abs(payload - 2) < 0.5]) for fleet in fleets]
lost, rule = margins[0] - np.array(margins), h * (speeds**2 - speeds[0] ** 2) / (3 * 9.81)
for speed, seen, told in zip(speeds[1:], lost[1:], rule[1:], strict=True):
    print(f"{speed} m/s costs {100 * seen:4.1f} cm of the margin, by the rule {100 * told:4.1f} cm")

# %% [markdown]
# ## The claim
#
# The block of the base is the lecture's closed form for the whole, and becomes the lecture's matrix as the
# arm fades; written out, the matrix outgrows paper while the recursion does not; the model of the whole is
# worth a factor of hundreds; haste tips the robot over; the hand can stay while the base drives; and from a
# payload of 2 kg on, the base must slow down.

# %%
assert largest < 1e-12, "the base's block is not the closed form of the lumped mass"
ratio = rest_of_it / shares
assert np.allclose(ratio[:6], ratio[0], rtol=1e-6), "the arm does not fade in proportion"
assert counted[-1, 0] < 10_000, "the recursion is long too"
assert counted[-1, 1] > 50 * counted[-1, 0], "the matrix written out is not so long"
whole, apart = (run.max_error() for run in runs.values())
assert (whole < 1e-3).all(), "computed torque of the whole errs"
assert (apart > 20 * whole).all(), "the coupling costs little"
assert tip_over_margin(runs["computed torque"]).min() > 0 > tip_over_margin(fast).min(), "it tips otherwise"
assert travelled.max() > 0.2, "the base does not drive"
assert max(metres, radians) < 1e-4, "the hand does not go where it should"
assert through.clearance.smallest < 0 < clearance(robot, reached.q).smallest, "it goes through itself"
safe = [heaviest(good) for good in fine]
assert np.abs(np.subtract(safe, [7, 6, 5, 4, 2])).max() <= 0.5, "other payloads are safe"
assert safe == [heaviest(within(fleet, "tip-over margin")) for fleet in fleets], "something else decides"
assert np.abs(lost - rule).max() < 0.01, "the rule is off by more than 1 cm"
assert all(fleet.engine == "COMPILED" and not fleet.diverged.any() for fleet in fleets), "some robot diverged"
cost = (apart / whole)[3:].max()
print(
    f"Shown: without the coupling a joint errs up to {cost:,.0f} times more; 99 of 100 robots carry "
    f"{safe[0]:.1f} kg at {speeds[0]} m/s, and {safe[-1]:.1f} kg at {speeds[-1]} m/s."
)
