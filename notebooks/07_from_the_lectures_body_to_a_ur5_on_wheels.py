# %% [markdown]
# # 7 From the lecture's body to a UR5 on wheels
#
# The lecture models a mobile robot like a manipulator: a chain of joints carries a body
# at its end. This notebook extends the chain. It has three joints in the plane, the
# body, and the six joints of a UR5. The equation of motion keeps its form,
#
# $$M(q)\,\ddot q + n(q, \dot q) = \tau, \qquad q = (x, y, \psi, \theta_1, \dots, \theta_6),$$
#
# and $M$ becomes a $9 \times 9$ matrix. The notebook answers four questions:
#
# - Where does $M$ contain the lecture's $3 \times 3$ matrix?
# - Up to how many joints is a derivation by hand practical?
# - How large are the errors if base and arm are controlled as two separate robots?
# - Above which payload must the base drive more slowly?

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
# The body is a homogeneous box of 30 kg. The UR5 stands on its top, 10 cm ahead of the
# middle and 5 cm to the right of it.

# %%
base = MobileRobot.box(30)
robot = base.mount("ur5", at=(0.1, -0.05, 0.2, 0.4))
posture = np.array([0, -1.2, 1.4, -0.2, 0.6, 0])
q = np.concatenate([[1, 2, 0.7], posture])
names = ", ".join(coordinate.name for coordinate in robot.coordinates)
print(f"{robot.nv} coordinates: {names}\n")
print(f"M(q) of the body alone:\n{base.mass_matrix(q[:3])}")
print(f"M(q) of body and arm:\n{robot.mass_matrix(q)}")

# %% [markdown]
# The upper left block belongs to the base, and the lower right block belongs to the
# arm. The other entries couple the two. An accelerating joint exerts a force on the
# base, and an accelerating base exerts torques on the joints.
#
# ## The lecture's matrix in M
#
# If all joints of the arm are locked, body and arm form one rigid body. The upper left
# block must therefore equal the lecture's closed form. The mass, the centre of mass and
# the yaw inertia in this form are those of body and arm together, at the given
# configuration of the arm. The next cell compares the two:

# %%
generator = np.random.default_rng(0)
samples = robot.random_configuration(generator, (100,))
largest = 0.0
for sample in samples:
    whole = robot.with_locked_arms(sample)
    by_hand = closed_form.mass_matrix(
        sample[:3], mass=whole.mass, yaw_inertia=whole.yaw_inertia, com=whole.com[:2]
    )
    largest = max(largest, np.abs(robot.mass_matrix(sample)[:3, :3] - by_hand).max())
print(f"largest difference at {len(samples)} random configurations: {largest:.1e}")

stretch = np.linspace(0, 1, 50)
stretched = np.array([0, -0.2, 0.1, 0, 0, 0])
lumps = [robot.with_locked_arms(share * stretched + (1 - share) * posture) for share in stretch]
figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3), layout="constrained")
left.plot(100 * stretch, [whole.yaw_inertia for whole in lumps], color=colour(0))
left.set(xlabel="extension of the arm [%]", ylabel="composite yaw inertia [kg m²]")
right.plot(100 * stretch, [np.hypot(*whole.com[:2]) for whole in lumps], color=colour(1))
right.set(xlabel="extension of the arm [%]", ylabel="distance to centre of mass [m]")
for axes in (left, right):
    dress(axes)

# %% [markdown]
# The lecture's body has a constant inertia $I_{cz}$ and a constant centre of mass
# $(x_{bc}, y_{bc})$. Here both depend on the configuration of the arm.
#
# ## An arm with vanishing mass
#
# Multiply all masses and inertias of the arm by a factor $s$. The difference between
# the upper left block and the lecture's matrix must then be proportional to $s$:

# %%
ARM = robot.mounts[0].model


def scaled_arm(share):
    """Return the base with an arm whose masses and inertias are scaled by `share`."""
    model = ARM.copy()
    for joint, inertia in enumerate(ARM.inertias):
        model.inertias[joint] = pin.Inertia(share * inertia.mass, inertia.lever, share * inertia.inertia)
    return base.mount(model, at=(0.1, -0.05, 0.2, 0.4), name="ur5")


shares = 10.0 ** -np.arange(0, 9)
lecture_matrix = base.mass_matrix(q[:3])
blocks = [scaled_arm(s).mass_matrix(q)[:3, :3] for s in shares]
differences = np.array([np.abs(block - lecture_matrix).max() for block in blocks])
figure, axes = plt.subplots(figsize=(6, 3), layout="constrained")
axes.loglog(shares, differences, "o-", color=colour(0))
axes.set(xlabel="factor $s$ of the arm's masses", ylabel="largest difference [SI]")
axes.set_title("Difference between M[:3, :3] and the lecture's matrix")
dress(axes)

# %% [markdown]
# ## The limit of the derivation by hand
#
# The lecture's recursion works for any number of joints, and `derivation` accepts any
# table. The next cell appends the six rows of the UR5 to the lecture's three rows. It
# counts the operations in $M(q)$ in two forms. The first form is written out, as on
# paper. The second form has named intermediate results, as a recursion computes them.

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
    """Return the derivation for the body and the first joints of the arm."""
    rows = [DHRow(*row, JointType.REVOLUTE, f"theta{k}") for k, row in enumerate(UR5_ROWS[:joints], start=1)]
    links = (None, None, BODY, *(derivation.Link.general(k) for k in range(1, joints + 1)))
    return derivation.derive(DHTable((*LECTURE_TABLE, *rows)), links, gravity=(0, 0, -g))


def operations(derived):
    """Return the number of operations in M: with named results, and written out."""
    named, written = 0, {}

    def cost(expression):
        if expression.is_Atom:
            return written.get(expression, 0)
        return expression.count_ops() + inside(expression)

    def inside(expression):
        parts = expression.args
        return sum(cost(part) if part.is_Atom else inside(part) for part in parts)

    for name, expression in derived.assignments:
        written[name] = cost(expression)
        named += expression.count_ops()
    entries = list(derived.mass_matrix)
    named += sum(entry.count_ops() for entry in entries)
    return named, sum(cost(entry) for entry in entries)


numbers = (0, 1, 2, 4, 6)  # joints
counted = np.array([operations(derived(joints)) for joints in numbers])
for joints, (named, written) in zip(numbers, counted, strict=True):
    print(f"{joints} joints: {named:6,} operations with named results, {written:8,} written out")

figure, axes = plt.subplots(figsize=(6, 3), layout="constrained")
for k, name in enumerate(("with named results", "written out")):
    axes.semilogy(numbers, counted[:, k], "o-", color=colour(k), label=name)
axes.set(xlabel="number of arm joints", ylabel="operations in $M(q)$")
axes.legend()
dress(axes)

# %% [markdown]
# An entry of the lecture's matrix takes one or two lines. With one joint of the arm,
# the matrix fills a page. With all six joints, it would fill a book. With named results
# it takes a few thousand operations: too many to read, but few for a computer. So the
# derivation by hand ends here, and the recursion continues. Pinocchio runs the same
# recursion with numbers.
#
# ## The cost of ignoring the coupling
#
# The base drives a circle of radius 1 m at 0.5 rad/s. Each joint moves by 0.5 rad and
# back within 6 s. The next cell compares two controllers:
#
# - Computed torque uses $M$ and $n$ of the complete robot.
# - The decoupled controller uses two models. The first is a base that carries the arm
#   as a load, locked at its current configuration. The second is an arm on a base at
#   rest. Each model alone is correct.
#
# The plant is integrated by `rk4`. The default integrator, from the lecture, keeps the
# acceleration constant within a step, as computed torque assumes. It would therefore
# hide the error of the zero-order hold.

# %%
joint_motion = CubicVia(posture, posture + 0.5, posture, t_via=3, t_end=6)
motion = WholeBody(robot, Tangent(Circle(1, 0.5, 6)), joint_motion)
controllers = {
    "computed torque": ComputedTorque(robot, 100, 20),
    "decoupled": Decoupled(robot, 100, 20),
}
runs = {
    name: simulate(robot, controller, motion, dt=0.001, integrator=rk4)
    for name, controller in controllers.items()
}
for name, run in runs.items():
    print(f"--- {name}\n{run}\n")
plots.errors(runs, title="Errors of both controllers; each panel has its own scale")

# %% [markdown]
# With the complete model, only the error of the zero-order hold of 1 ms remains:
# micrometres, and less than 0.1 mrad. The decoupled controller with the same gains has
# errors of tenths of a millimetre and of milliradians. The rule of [notebook
# 6](06_how_wrong_may_the_model_be.ipynb) explains these errors. The error is about
# $M^{-1}$ times the force that the controller model lacks, divided by $k_p$.
#
# ## The load on the base
#
# The arm exerts forces on the base, and the ground must support all of them. If the
# zero-moment point reaches the edge of the footprint, the robot tips over. The next
# cell runs the same motion six times as fast:

# %%
fast_joints = CubicVia(posture, posture + 0.5, posture, t_via=0.5, t_end=1)
fast_motion = WholeBody(robot, Tangent(Circle(1, 3, 1)), fast_joints)
fast = simulate(robot, controllers["computed torque"], fast_motion, dt=0.001, integrator=rk4)
for name, run in {"6 s": runs["computed torque"], "1 s": fast}.items():
    force = np.linalg.norm(reaction_wrench(run)[:, :2], axis=1).max()
    print(
        f"motion in {name}: the arm exerts up to {force:5.1f} N on the base; "
        f"tip-over margin {tip_over_margin(run).min():6.3f} m, "
        f"friction coefficient needed {required_friction(run).max():.3f}"
    )
plots.balance(fast, title="Motion in 1 s: balance on the ground")

# %% [markdown]
# ## Poses of the end effector
#
# The robot has nine coordinates, and a pose determines six of them. Three remain free.
# `PosePath.through` makes a smooth path through poses at given times. Here the end
# effector travels 1.2 m and turns by three quarters of a turn about its axis.
# `solve_inverse_kinematics` computes a motion of base and arm, step by step and within
# the limits of the joints. The controller `EndEffectorTracking` tracks the pose
# directly. The coordinates that the pose leaves free follow the reference.

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
forward, lateral = 100 * travelled
print(f"motion of the base: {forward:.0f} cm forward, {lateral:.0f} cm sideways")
print(f"largest error of the end effector: {1e6 * metres:.0f} µm, {1e6 * radians:.0f} µrad")
plots.end_effector(reached, title="The end effector passes through four poses")

# %% [markdown]
# Collisions of the robot with itself need a separate check. `clearance` computes the
# distances between the collision geometries: the meshes of the UR5 and the box. It
# leaves out neighbouring bodies and pairs that can never touch, and it reports them.
# The next path ends inside the body of the robot. The inverse kinematics follows this
# path with an error below a hundredth of a millimetre. If a clearance is required,
# `solve_inverse_kinematics` raises an error:

# %%
print(f"four poses: {clearance(robot, reached.q).summary}")
into_itself = PosePath(RestToRest(held[:3, 3], (0.2, 0.15, 0.12), 4))
standing = np.where(np.arange(9) < 3, 0, robot.velocity_limit)
options = {"q0": start, "velocity_limit": standing}
through = solve_inverse_kinematics(robot, into_itself, **options)
print(f"path into the body: {through.clearance.summary}")
print(f"largest error: {1e3 * through.max_error()[0]:.3f} mm")
try:
    solve_inverse_kinematics(robot, into_itself, clearance=0.01, **options)
except Unreachable as error:
    print(f"with a required clearance: {error}")

# %% [markdown]
# ## Payload and speed
#
# The base drives the lecture's circle of radius 3 m, at the lecture's speed of 0.3 m/s
# and at up to nine times this speed. The arm is stretched out and holds a payload. It
# swings the payload from one side to the other and back in 6 s. Ten thousand robots
# hold payloads of 0 to 12 kg. Each controller model has the true mass of the payload.
# It places the centre of mass 10 cm ahead of the tool. The true position deviates from
# this, with a standard deviation of 3 cm along this direction and 2 cm to the sides.
# The same ten thousand robots drive at each of five speeds. They must satisfy three
# limits:
#
# - The end effector deviates from its reference by at most 1 cm.
# - No joint needs more torque than its effort limit.
# - The tip-over margin is not negative.

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
limits = {"end effector": 0.01, "effort": 1.0, "tip-over margin": 0.0}  # [m, -, m]
payload, edges = fleets[0].draws["loads.0.mass"], np.arange(0, 12.5, 0.5)
bins, middles = np.digitize(payload, edges) - 1, edges[:-1] + 0.25


def within(fleet, name):
    """Return a mask of the robots that satisfy a limit."""
    found = fleet.largest(name)
    return found >= limits[name] if "margin" in name else found <= limits[name]


def share_of(fine):
    """Return the share of robots in each payload bin that satisfy the limits [%]."""
    return np.array([100 * fine[bins == k].mean() for k in range(len(middles))])


def heaviest(fine):
    """Return the payload up to which 99 of 100 robots satisfy the limits [kg]."""
    few = share_of(fine) < 99
    return edges[few.argmax()] if few.any() else edges[-1]


fine = [np.all([within(fleet, name) for name in limits], axis=0) for fleet in fleets]
print("payload [kg] up to which 99 of 100 robots satisfy the limits")
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
styles = {
    "end effector": ("error of the end effector", "o:", 6),
    "effort": ("torques of the joints", "s--", -14),
    "tip-over margin": ("tip-over margin", "^-", 7),
}
for name, (label, style, above) in styles.items():
    bounds = [heaviest(within(fleet, name)) for fleet in fleets]
    right.plot(speeds, bounds, style, color=INK, markersize=7)
    place = {"xytext": (8, above), "textcoords": "offset points"}
    right.annotate(label, (speeds[0], bounds[0]), **place)
right.fill_between(speeds, [heaviest(good) for good in fine], color=tint(colour(0), 0.25))
right.set(xlabel="speed of the base [m/s]", ylim=(0, 12))
right.set_ylabel("largest payload for 99 of 100 [kg]")
for axes in (left, right):
    dress(axes)

# %% [markdown]
# In the shaded region 99 of 100 robots satisfy all limits. The limits of the end
# effector and of the joints hardly depend on the speed. The end effector deviates
# because the controller model has the wrong centre of mass of the payload. The joints
# carry the weight of the payload at every speed. The tip-over margin is the strictest
# limit, and it depends on the speed. It allows 6.5 kg at 0.3 and 0.9 m/s, 5.5 kg at 1.5
# m/s, 4 kg at 2.1 m/s, and 2 kg at 2.7 m/s. Slower driving does not allow more than 6.5
# kg: a heavier payload at the side tips even a slow base.
#
# A calculation by hand gives the effect of the speed. On a circle of radius $r$ at
# speed $v$, the centrifugal force is $m v^2 / r$. It acts on the centre of mass at
# height $h$ and shifts the zero-moment point by $h v^2 / (r g)$.

# %%
h = carrier.with_locked_arms(np.concatenate([np.zeros(3), stretched])).com[2]
about_2_kg = np.abs(payload - 2) < 0.5
margins = [np.median(fleet.largest("tip-over margin")[about_2_kg]) for fleet in fleets]
lost = margins[0] - np.array(margins)
rule = h * (speeds**2 - speeds[0] ** 2) / (3 * 9.81)
print("reduction of the tip-over margin relative to 0.3 m/s, payloads of about 2 kg")
for speed, simulated, by_hand in zip(speeds[1:], lost[1:], rule[1:], strict=True):
    print(f"{speed} m/s: simulated {100 * simulated:.1f} cm, by hand {100 * by_hand:.1f} cm")

# %% [markdown]
# ## The claim
#
# - The block of the base equals the lecture's closed form with the mass properties of
#   body and arm together. It becomes the lecture's matrix as the masses of the arm
#   vanish.
# - The matrix, written out, becomes too long for paper. The recursion stays short.
# - Without the coupling, the errors of the joints are up to hundreds of times as large.
# - The fast motion tips the robot over.
# - The end effector passes through its poses while the base drives.
# - With a payload above 2 kg, the base must drive more slowly than 2.7 m/s.

# %%
assert largest < 1e-12, "the block of the base differs from the closed form"
ratio = differences / shares
assert np.allclose(ratio[:6], ratio[0], rtol=1e-6), "the difference is not proportional"
assert counted[-1, 0] < 10_000, "the recursion is long"
assert counted[-1, 1] > 50 * counted[-1, 0], "the matrix written out is short"
whole, apart = (run.max_error() for run in runs.values())
assert (whole < 1e-4).all(), "computed torque has large errors"
assert (apart > 20 * whole).all(), "the coupling has little effect"
slow_margin = tip_over_margin(runs["computed torque"]).min()
assert slow_margin > 0 > tip_over_margin(fast).min(), "the wrong motion tips over"
assert travelled.max() > 0.2, "the base does not drive"
assert max(metres, radians) < 1e-4, "the end effector misses its poses"
assert clearance(robot, reached.q).smallest > 0, "the robot collides with itself"
assert through.clearance.smallest < 0, "the path into the body has no collision"
safe = [heaviest(good) for good in fine]
assert np.abs(np.subtract(safe, [6.5, 6.5, 5.5, 4, 2])).max() <= 0.5, "other payloads are safe"
tipping = [heaviest(within(fleet, "tip-over margin")) for fleet in fleets]
assert safe == tipping, "another limit is the strictest"
assert np.abs(lost - rule).max() < 0.01, "the rule is off by more than 1 cm"
for fleet in fleets:
    assert fleet.engine == "COMPILED", "an ensemble is not compiled"
    assert not fleet.diverged.any(), "a robot diverged"
cost = (apart / whole)[3:].max()
print(
    f"Shown: without the coupling the error of a joint is up to {cost:,.0f} times as large; "
    f"99 of 100 robots carry {safe[0]:.1f} kg at {speeds[0]} m/s and {safe[-1]:.1f} kg "
    f"at {speeds[-1]} m/s."
)
