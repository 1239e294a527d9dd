# %% [markdown]
# # 9 When wheels slip
#
# In notebook 8 the wheels rolled without slip, whatever force this required. Real
# ground exerts limited forces. A wheel with the load $N$ receives at most the force
# $\mu N$ along the ground, in any direction. If the required force is smaller, the
# wheel sticks. Otherwise it slides, and the force is $\mu N$ against the sliding
# velocity. This is Coulomb's law of dry friction,
#
# $$|\lambda| \le \mu N, \qquad \lambda = -\mu N \frac{s}{|s|} \ \text{ if the wheel slides with } s \ne 0 .$$
#
# The notebook answers six questions:
#
# - How far does a robot with locked wheels slide?
# - Does it stay at rest on a ramp?
# - How does a base turn if it cannot turn without slip?
# - At which speed does a robot slip in a turn, and how many of two thousand robots
#   slip?
# - How accurate is odometry if one wheel is one percent smaller than assumed?
# - Which forces does an arm cause at the wheels?

# %%
import matplotlib.pyplot as plt
import numpy as np

from pinmobile import (
    Backstepping,
    Circle,
    ComputedTorque,
    Coulomb,
    EndEffectorTracking,
    Engine,
    FixedHeading,
    Hold,
    Lissajous,
    MobileRobot,
    Motor,
    Normal,
    PosePath,
    RestToRest,
    SameAs,
    Spline,
    Tangent,
    UnicycleTracking,
    Uniform,
    WheeledRobot,
    WheelTable,
    ensemble,
    law,
    parts,
    plots,
    simulate,
    solve_inverse_kinematics,
)
from pinmobile.balance import contact_loads, max_path_speed, slip_margins, tip_over_margin
from pinmobile.controllers import WheelSpeed
from pinmobile.plots.style import INK, colour, dress
from pinmobile.wheels import OdometryFeedback, Ramp, WheelFriction

np.set_printoptions(precision=3, suppress=True, linewidth=110)
g = 9.81  # [m/s^2]

# %% [markdown]
# ## Locked wheels slide
#
# A base of 30 kg has four wheels that do not turn, because of a very large rolling
# resistance. It starts at a speed $v$. Friction decelerates it by $\mu g$, whatever the
# mass. So it slides the distance $v^2 / (2 \mu g)$:

# %%
wheel = {"mass": 1.0, "spin_inertia": 0.01, "yaw_inertia": 0.006}
body = MobileRobot(30.0, 2.3, com=(0, 0, 0.2))


@law
def nothing(t, q, v, reference):
    """Return zero torques for both motors."""
    return np.zeros(2)


def left_alone(robot, duration, v=None, engine=Engine.COMPILED):
    """Return the run of a robot without torques, from rest or from given velocities."""
    still = FixedHeading(Hold([0.0, 0.0], duration), 0.0)
    start = {"q0": robot.rest, "v0": np.zeros(robot.nv) if v is None else v}
    return simulate(robot, nothing, still, dt=0.01, engine=engine, limit=1e9, **start)


def locked(mu, ramp=None):
    """Return the base with locked wheels."""
    friction = WheelFriction(mu=mu, rolling=1e3)
    table = WheelTable.skid_steer(0.5, 0.4, 0.1, friction=friction, **wheel)
    return WheeledRobot(body, table, Coulomb(ramp=ramp))


speeds, coefficients = np.array([0.5, 1, 1.5, 2, 2.5, 3]), (0.3, 0.5, 0.8)
slid = {mu: [] for mu in coefficients}
for mu in coefficients:
    robot = locked(mu)
    for speed in speeds:
        run = left_alone(robot, 1.2, np.array([speed, *np.zeros(robot.nv - 1)]))
        slid[mu].append(run.q[-1, 0])
off_by = max(np.abs(slid[mu] - speeds**2 / (2 * mu * g)).max() for mu in coefficients)
print(f"largest difference from v^2 / (2 mu g): {1e3 * off_by:.3f} mm, time step 10 ms")

figure, axes = plt.subplots(figsize=(6.5, 3.4), layout="constrained")
fine = np.linspace(0, 3, 100)
for k, mu in enumerate(coefficients):
    axes.plot(fine, fine**2 / (2 * mu * g), ("-", "--", ":")[k], color=colour(k))
    axes.plot(speeds, slid[mu], "os^"[k], color=colour(k), label=rf"$\mu$ = {mu}")
axes.set(xlabel="initial speed [m/s]", ylabel="sliding distance [m]")
axes.set_title(r"Markers: simulation. Lines: $v^2 / (2 \mu g)$", fontsize=11)
axes.legend(frameon=False)
dress(axes)

# %% [markdown]
# ## A ramp
#
# On a ramp of angle $\alpha$, the weight pulls the base down with $m g \sin\alpha$.
# Friction holds up to $\mu m g \cos\alpha$. At $\tan\alpha = 0.98\,\mu$ the base must
# stay at rest permanently. At $1.02\,\mu$ it must slide with the exact acceleration
# $g (\sin\alpha - \mu \cos\alpha)$. This is a hard test for a simulation: with smoothed
# friction, a base creeps down every slope.

# %%
mu, stands, slides = 0.5, np.arctan(0.98 * 0.5), np.arctan(1.02 * 0.5)
still = left_alone(locked(mu, Ramp(stands)), 10.0)
moving = left_alone(locked(mu, Ramp(slides)), 10.0)
crept = np.abs(still.q).max()
down = g * (np.sin(slides) - mu * np.cos(slides))
off_ramp = np.abs(moving.v[:, 0] + down * moving.t).max()
print(f"at 0.98 of the limit: displacement {crept:.0e} m in {len(still) - 1:,} steps")
print(f"at 1.02 of the limit: final speed {down * 10:.2f} m/s by the formula,")
print(f"largest difference of the simulated speed {off_ramp:.0e} m/s")

# %% [markdown]
# ## A base that turns by sliding
#
# Husky and Jackal have four wheels that point forward. One gear train drives the two
# wheels of each side. Such a base cannot turn unless its wheels slide sideways. Let the
# left wheels turn backwards and the right wheels forward, each at the surface speed
# $u$. Without slip the yaw rate would be $\omega = u / b$, with $b$ half the track. The
# true yaw rate is smaller, as if the track were wider.
#
# At each wheel, friction acts against the sliding velocity. This velocity is
# $u - \omega b$ along the wheel and $\omega l_x$ across it, with $l_x$ half the
# wheelbase. In a steady turn the four forces have no moment about the middle. For equal
# loads this gives $b\,(u - \omega b) = l_x\,\omega l_x$, and so
#
# $$\frac{\text{effective track}}{\text{track}} = \frac{u}{\omega b} = 1 + \left(\frac{l_x}{b}\right)^2 .$$
#
# The friction coefficient does not appear. The makers' controllers have this ratio as a
# parameter, `wheel_separation_multiplier`, and its value was found by trials
# (husky/husky dff7c81, jackal/jackal c6ab6ca).


# %%
def effective_track(robot, table):
    """Return effective track / track of a base in a slow turn in place."""
    base, surface = WheeledRobot(robot, table), 0.02  # [m/s] of the wheels
    turning = surface / table.wheels[0].radius * np.array([-1.0, 1.0, -1.0, 1.0])
    start = np.concatenate([np.zeros(3), turning])
    run = left_alone(base, 0.3, start, Engine.PYTHON)
    radius, half = table.wheels[0].radius, table.wheels[0].y
    return run.v[-1, 4] * radius / run.v[-1, 2] / half


def skidding(wheelbase, track, radius, mu):
    """Return four wheels with constant rates: their motors have very large rotor inertias."""
    options = {"friction": WheelFriction(mu=mu, rolling=0.0)}
    options["motor"] = Motor(rotor_inertia=1e6)
    return WheelTable.skid_steer(wheelbase, track, radius, **wheel, **options)


frictions, shapes = (0.2, 0.5, 1.0), np.array([0.5, 1.0, 1.5])
seen = {}
for mu in frictions:
    tables = [skidding(0.4 * shape, 0.4, 0.1, mu) for shape in shapes]
    seen[mu] = [effective_track(body, table) for table in tables]
bases = {
    # mass, yaw inertia, centre of mass; wheelbase, track, radius; configured multiplier
    "Husky": (MobileRobot(56.58, 2.5, com=(0, 0, 0.189)), (0.512, 0.5708, 0.1651), 1.875),
    "Jackal": (MobileRobot(18.43, 0.5, com=(0, 0, 0.1)), (0.262, 0.3756, 0.098), 1.5),
}
found = {}
for name, (robot, size, _) in bases.items():
    found[name] = effective_track(robot, skidding(*size, 0.6))
print("effective track / track")
for name, (_, size, configured) in bases.items():
    rule = 1 + (size[0] / size[1]) ** 2
    multipliers = f"1 + (lx/b)^2 = {rule:.3f}, configured {configured:.3f}"
    print(f"{name:6} simulated {found[name]:.3f}, {multipliers}")
front_heavy = MobileRobot(30.0, 2.3, com=(0.08, 0, 0.2))
ahead = effective_track(front_heavy, skidding(0.4, 0.4, 0.1, 0.6))
print(f"square base, centre of mass in the middle: {seen[0.5][1]:.2f}")
print(f"square base, centre of mass 8 cm ahead: {ahead:.2f}")

figure, axes = plt.subplots(figsize=(7, 3.8), layout="constrained")
fine = np.linspace(0.3, 1.7, 100)
axes.plot(fine, 1 + fine**2, color=INK, linewidth=1.2, label="$1 + (l_x/b)^2$")
for k, mu in enumerate(frictions):
    marker = {"marker": "os^"[k], "markersize": (12, 8, 4)[k], "linestyle": ""}
    axes.plot(shapes, seen[mu], color=colour(k), label=rf"simulated, $\mu$ = {mu}", **marker)
for name, (_, size, configured) in bases.items():
    at = size[0] / size[1], configured
    axes.plot(*at, "x", color=INK, markersize=9, markeredgewidth=2)
    axes.annotate(name, at, (-10, 10), textcoords="offset points", ha="right")
axes.plot([], [], "x", color=INK, markeredgewidth=2, label="configured by the makers")
axes.set(xlabel="wheelbase / track, $l_x / b$ [-]", ylabel="effective track / track [-]")
axes.legend(frameon=False)
dress(axes)

# %% [markdown]
# The markers of the three friction coefficients coincide. The configured values of
# Husky and Jackal lie within 4 % of the rule. Compliant tyres, unequal loads or the
# floor may cause the rest of the difference. These numbers cannot separate the causes.
# Loads do have an effect. With the centre of mass 8 cm ahead, the front wheels carry so
# much load that they stick. The base then turns about the middle of the front axle, and
# the rear wheels slide sideways.
#
# ## A turn too fast
#
# A differential drive of 27 kg has half of its weight on the two wheels and the rest on
# casters. It follows an ellipse with tight ends. While the wheels roll, the model of
# notebook 8 gives the forces of the ground on the wheels, and `contact_loads` gives
# their loads. The **slip margin** is the friction that is left. The rolling model gives
# only the sum $Y$ of the forces across the axle, so the margin is that of the axle:
#
# $$\sum_i \sqrt{(\mu N_i)^2 - \lambda_{i,\mathrm{along}}^2} \;-\; |Y|$$
#
# Before any simulation, `max_path_speed` computes how fast the drive can follow the
# path on ground with $\mu = 0.4$, and which limit it reaches first. Two simulations
# follow, one slightly below this speed and one slightly above it. They have the same
# friction coefficient. Their tyres creep by 0.1 mm/s per newton before they slide, as
# real tyres do. The creep determines how the two wheels share the force across the
# axle.

# %%
places, limited = [(0.25, 0), (-0.25, 0)], Motor(torque_limit=6.0)
driven = WheelTable.differential(0.5, 0.1, supports=places, motor=limited, **wheel)
light = MobileRobot(27.0, 2.3, com=(0, 0, 0.15))


def on(friction):
    """Return the wheel table with this friction."""
    options = {"supports": places, "motor": limited, "friction": friction}
    return WheelTable.differential(0.5, 0.1, **options, **wheel)


rolling = WheeledRobot(light, on(WheelFriction(mu=0.4)))
slippery = WheeledRobot(light, on(WheelFriction(mu=0.4, slip=1e-4)), Coulomb())


def ellipse(factor):
    """Return an ellipse of 4 m by 2 m: one lap takes 4 pi / factor seconds."""
    duration = round(4 * np.pi / factor, 2)
    return Tangent(Lissajous(2, 1, 0.5 * factor, 0.5 * factor, duration))


limit = max_path_speed(rolling, ellipse(1))
print(f"limit: {limit.factor:.3f} times as fast, {limit.value:.2f} m/s ({limit.event})")
firmware = WheelSpeed(UnicycleTracking(b=0.3), rolling, kp=3, ki=10)
turns, margins = {}, {}
for share in (0.97, 1.1):
    quick = ellipse(share * limit.factor)
    name = f"{share:g} of the limit"
    margins[name] = simulate(rolling, firmware, quick, dt=0.01, engine=Engine.COMPILED)
    turns[name] = simulate(slippery, firmware, quick, dt=0.01, engine=Engine.COMPILED)
    slid_at = turns[name].metrics()["slip"][1]
    left_over = slip_margins(margins[name]).values.min()
    print(f"{name}: margin {left_over:.2f} N without slip; largest slip {slid_at.max():.1g} m/s")

# %%
figure, (left, right) = plt.subplots(1, 2, figsize=(11, 3.8), layout="constrained")
for k, (name, run) in enumerate(turns.items()):
    style = {"color": colour(k), "linestyle": ("-", "--")[k], "linewidth": 2.2}
    style["label"] = name
    left.plot(run.t, slip_margins(margins[name]).values[:, 0], **style)
    right.plot(*run.q[:, :2].T, **style)
left.axhline(0, color=INK, linewidth=1)
left.set(xlabel="t [s]", ylabel="slip margin of the axle [N]", title="Model without slip")
right.plot(*run.reference.q[:, :2].T, color=INK, linewidth=1, label="reference")
right.set(xlabel="x [m]", ylabel="y [m]", title="Simulation with slip", aspect="equal")
lines = right.get_legend_handles_labels()
figure.legend(*lines, loc="outside lower center", ncols=3, frameon=False)
for axes in (left, right):
    dress(axes)

# %%
name = "0.97 of the limit"
plots.friction(turns[name], title=f"{name}: forces in the friction circle")

# %%
name = "1.1 of the limit"
plots.friction(turns[name], title=f"{name}: forces in the friction circle")

# %% [markdown]
# Below the limit, the inner wheel carries less load in a turn. At the tight ends its
# force reaches the edge of the friction circle, and it creeps by millimetres per
# second. The outer wheel exerts the rest of the force, almost at its limit. Above the
# limit the margin is negative, and both wheels slide. Nothing else can exert the
# missing force. A wheel that slides sideways has no friction left along its direction.
# So its motor spins the wheel up and does not drive the robot. The robot leaves the
# path at the first tight end.
#
# ## How many of two thousand?
#
# The friction coefficient of a floor is uncertain. Two thousand robots drive on a
# circle of 2 m radius. Their $\mu$ is uniform between 0.2 and 0.8, and the height of
# their centre of mass is uniform between 0.1 and 0.2 m. The first ensemble rolls, and a
# robot with a negative slip margin would slip. The second ensemble drives on `Coulomb`
# ground, where wheels do slip. It counts the robots that slide faster than 1 mm/s. By
# hand, half of the weight on the wheels gives the rule $v^2 / R = \mu g / 2$.

# %%
judged = WheeledRobot(light, driven)
steering = Backstepping(UnicycleTracking(), judged)
uncertain = {
    "left.friction.mu": Uniform(0.2, 0.8),
    "right.friction.mu": SameAs("left.friction.mu"),
    "com.z": Uniform(0.1, 0.2),
}
paces = np.array([1.4, 1.6, 1.8, 2.0, 2.2, 2.4, 2.6, 2.8])
predicted, simulated, agreed = [], [], []
for pace in paces:
    circle = Tangent(Circle(2, pace / 2, 1))
    options = {"n": 2_000, "spread": uncertain, "dt": 0.01}
    rolled = ensemble(judged, steering, circle, **options)
    negative = rolled.largest("slip margin") < 0
    predicted.append(np.mean(negative))
    if pace in (1.6, 2.0, 2.4):
        ground = WheeledRobot(light, driven, Coulomb())
        slides = ensemble(ground, steering, circle, **options).largest("slip") > 1e-3
        simulated.append(np.mean(slides))
        agreed.append(np.mean(slides == negative))
by_hand = np.clip((2 * paces**2 / (2 * g) - 0.2) / 0.6, 0, 1)
print("robots of 2,000 that slip")
for pace, share, by_rule in zip(paces, predicted, by_hand, strict=True):
    print(f"at {pace} m/s: margin {2_000 * share:5,.0f}, by hand {2_000 * by_rule:5,.0f}")
print(f"both ensembles agree on at least {100 * min(agreed):.2f} % of the robots")

figure, axes = plt.subplots(figsize=(6.5, 3.4), layout="constrained")
fine = np.linspace(1.3, 2.9, 100)
rule = 100 * np.clip((fine**2 / g - 0.2) / 0.6, 0, 1)
axes.plot(fine, rule, color=INK, label=r"by hand, $v^2 / R = \mu g / 2$")
style = {"color": colour(0), "markersize": 9, "label": "negative margin without slip"}
axes.plot(paces, 100 * np.array(predicted), "o", **style)
style = {"color": colour(1), "label": "simulation with slip"}
axes.plot([1.6, 2.0, 2.4], 100 * np.array(simulated), "^", **style)
axes.set(xlabel="speed on a circle of 2 m [m/s]", ylabel="robots that slip [%]")
axes.legend(frameon=False)
dress(axes)

# %% [markdown]
# ## How accurate is odometry?
#
# A wrong wheel radius causes an error of odometry, even without slip.
# `OdometryFeedback` computes the pose from the wheel angles and an assumed wheel table.
# Its controller receives this pose. Let the left wheel be 1 % smaller than assumed, and
# let the reference be a straight path of 10 m. By hand, the left side travels 1 % less.
# With a track of 0.5 m, the heading turns by $0.01 / 0.5$ rad per metre. After 10 m the
# robot is $\frac{1}{2} \cdot 0.02 \cdot 10^2 = 1$ m to the left of the path.

# %%
straight = Tangent(RestToRest((0, 0), (10, 0), duration=20))
by_odometry = OdometryFeedback(steering, driven)
smaller = parts.replace(judged, {"table.wheels.left.radius": 0.099})
misled = simulate(smaller, by_odometry, straight, dt=0.02, engine=Engine.COMPILED)
aside = misled.q[-1, 1]
estimate = misled.signals["believed_pose"].values[-1]
print(f"pose by odometry: x {estimate[0]:.3f} m, y {1e3 * estimate[1]:.3f} mm")
print(f"true pose: x {misled.q[-1, 0]:.3f} m, y {aside:.3f} m, psi {misled.q[-1, 2]:.3f} rad")
plots.odometry(misled, title="Straight path, left wheel 1 % smaller than assumed")

# %% [markdown]
# In the next ensemble, each wheel radius of two thousand robots has a standard
# deviation of 0.5 %. The difference of the two radii then has $\sqrt 2$ times this
# standard deviation. The distance from the path at the end is half of the difference
# times $10^2$, divided by the track:

# %%
fleet = ensemble(
    judged,
    by_odometry,
    straight,
    n=2_000,
    spread={"left.radius": Normal(0.1, 0.0005), "right.radius": Normal(0.1, 0.0005)},
    dt=0.02,
)
shares = {0.5: 0.6745, 0.9: 1.6449, 0.99: 2.5758}  # share: standard deviations, normal
strayed = {share: fleet.error_quantile(share).distance for share in shares}
ruled = {share: k * np.sqrt(2) * 0.005 / 0.5 * 100 / 2 for share, k in shares.items()}
for share in shares:
    error = f"{strayed[share]:.2f} m, by hand {ruled[share]:.2f} m"
    print(f"largest distance of {100 * share:g} % of the robots: {error}")

# %% [markdown]
# After 10 m, about half of the robots are half a metre or more from the path, without
# any slip. So a robot needs sensors of its environment besides odometry.
#
# ## With an arm
#
# A UR5 stands on a Ridgeback, a base on mecanum wheels. The data of the base come from
# its file with locked wheels (ridgeback/ridgeback f38b789). Its front axle hangs on a
# rocker, which is fixed here. The end effector draws a wave on a wall, 2 m long, in 5
# s. The wave is longer than the arm. `solve_inverse_kinematics` computes a motion of
# base and arm together. `EndEffectorTracking` follows the wave with the torques of ten
# motors: four wheels and six joints. The friction coefficient is assumed to be 0.4.

# %%
rollers = WheelTable.mecanum(
    0.638,
    0.551,
    0.0759,
    mass=2.3,
    spin_inertia=6.6424e-3,
    yaw_inertia=3.3212e-3,
    friction=WheelFriction(mu=0.4, across=0.0, rolling=0.0),
)
centre, size = (0.01017, 0.0017, 0.09031), (0.96, 0.793, 0.31)
ridgeback = MobileRobot(195.038, 11.7683, com=centre, size=size)
painter = WheeledRobot(ridgeback, rollers).mount("ur5", at=(0.2, 0, 0.31, 0))
begin = np.array([0, 0, 0, 0, -1.2, 1.6, -0.4, 1.57, 0])
hand = painter.robot.frame_pose(begin)
times = np.linspace(0, 5, 41)
way = (times / 5) ** 3 * (10 - 15 * (times / 5) + 6 * (times / 5) ** 2)
wave = hand[:3, 3] + np.stack([0 * way, 2 * way, 0.15 * np.sin(4 * np.pi * way)], axis=-1)
target = PosePath(Spline(wave, times), hand[:3, :3])
motion = solve_inverse_kinematics(painter.robot, target, q0=begin, dt=0.02)
painted = simulate(painter, EndEffectorTracking(painter, target, dt=0.01), motion, dt=0.01)
at = painter.robot.frame_pose(painted.q[:, :9])[:, :3, 3]
missed = np.linalg.norm(at - target(painted.t).pose[:, :3, 3], axis=1)
margin, carried = slip_margins(painted), contact_loads(painted)
needed = np.abs(margin.along) / carried.values
print(f"motion of the base: {painted.q[-1, 1]:.2f} m sideways")
print(f"largest error of the end effector: {1e3 * missed.max():.2f} mm")
for name, least, load in zip(
    margin.names, margin.values.min(axis=0), carried.values.min(axis=0), strict=True
):
    print(f"{name:12} smallest load {load:3.0f} N, smallest slip margin {least:3.0f} N")
print(f"friction coefficient needed: {needed.max():.3f}")
print(f"smallest tip-over margin: {100 * tip_over_margin(painted).min():.0f} cm")

# %%
figure, (left, right) = plt.subplots(1, 2, figsize=(11, 3.6), layout="constrained")
wanted = target(painted.t).pose[:, 1:3, 3].T
left.plot(*wanted, color=INK, linewidth=1, zorder=4, label="target")
left.plot(*at[:, 1:].T, color=colour(0), linewidth=4, label="end effector")
left.plot(
    painted.q[:, 1],
    0 * painted.t + 0.35,
    "--",
    color=colour(1),
    linewidth=2,
    label="middle of the base (y only)",
)
left.set(xlabel="y [m]", ylabel="z [m]", title="Wave on the wall", ylim=(0.3, 0.75))
left.legend(frameon=False, loc="upper right", ncols=2, fontsize=9)
for k, name in enumerate(margin.names):
    style = {"linestyle": ("-", "--", ":", "-.")[k], "color": colour(k), "linewidth": 2}
    right.plot(painted.t, margin.values[:, k], **style, label=name.replace("_", " "))
right.set(xlabel="t [s]", ylabel="slip margin [N]", title="Slip margins of the wheels")
right.set_ylim(bottom=0)
right.legend(frameon=False, ncols=2)
for axes in (left, right):
    dress(axes)

# %% [markdown]
# The arm stands ahead of the middle of the base. So the rear wheels carry less load and
# have the smallest margins. The next cell checks the friction coefficient needed, on
# ground where wheels can slip. With slightly more friction than needed, no wheel may
# slide. With slightly less, at least one wheel must slide.

# %%
follower = ComputedTorque(painter, kp=100, kd=20)
rolled = simulate(painter, follower, motion, dt=0.01, engine=Engine.COMPILED)
least = (np.abs(slip_margins(rolled).along) / contact_loads(rolled).values).max()
slips = {}
for share in (1.02, 0.98, 0.6):
    floor = WheeledRobot(painter.robot, rollers, Coulomb(share * least))
    tried = simulate(floor, follower, motion, dt=0.01, engine=Engine.COMPILED)
    slips[share] = tried.metrics()["slip"][1].max()
    reached = painter.robot.frame_pose(tried.q[:, :9])[:, :3, 3]
    off = np.linalg.norm(reached - target(tried.t).pose[:, :3, 3], axis=1).max()
    often = 100 * tried.signals["slides"].values.any(axis=1).mean()
    print(
        f"{share:4} of the friction needed: a wheel slides {often:4.1f} % of the time, "
        f"largest error {1e3 * off:5.1f} mm"
    )

# %% [markdown]
# If one wheel slides for a moment, the other wheels and the feedback compensate for it.
# With much less friction than needed, the end effector misses the wave.
#
# ## The claim
#
# - Dry friction holds a base at rest without creep. A sliding base moves as Coulomb's
#   law states.
# - A skid-steer base turns as if its track were wider by the factor $1 + (l_x / b)^2$,
#   for every friction coefficient.
# - The slip margins of a rolling model predict which robots slide on real ground. This
#   holds for one robot, for two thousand robots, and for a base with an arm.
# - The accuracy of odometry depends on the accuracy of the wheel radii.

# %%
assert off_by < 5e-4, "locked wheels slide another distance"
assert crept < 1e-14, "the base creeps on the ramp"
assert off_ramp < 1e-11, "the base slides down with another acceleration"
for mu in frictions:
    assert np.allclose(seen[mu], 1 + shapes**2, rtol=1e-4), "friction changes the track"
for name, (_, size, configured) in bases.items():
    rule = 1 + (size[0] / size[1]) ** 2
    assert abs(found[name] / rule - 1) < 0.005, "the rule gives another track"
    assert abs(found[name] / configured - 1) < 0.045, "the makers configure another track"
assert abs(ahead - 1) < 1e-3, "the front wheels do not stick under a mass ahead"
assert limit.event == "left + right slip", "another limit comes first"
slow, quick = (run.metrics()["slip"][1].max() for run in turns.values())
assert slow < 0.02, "the robot slides below the limit"
both = turns["0.97 of the limit"].signals["slides"].values.all(axis=1)
assert not both.any(), "both wheels slide below the limit"
assert quick > 1, "the robot does not slide above the limit"
first = next(iter(turns.values())).max_error()[:2].max()
assert first < 0.05, "the robot leaves the path below the limit"
least_margins = [slip_margins(run).values.min() for run in margins.values()]
assert least_margins[0] > 0 > least_margins[1], "a margin has the wrong sign"
assert np.abs(np.array(predicted) - by_hand).max() < 0.02, "the rule differs by over 2 %"
assert min(agreed) > 0.995, "the margins do not predict the slip"
assert abs(aside - 1) < 0.02, "the robot ends elsewhere"
assert np.hypot(estimate[0] - 10, estimate[1]) < 5e-3, "the estimate is not at the goal"
for share in shares:
    assert abs(strayed[share] / ruled[share] - 1) < 0.05, "the rule differs by over 5 %"
assert missed.max() < 1e-3, "the end effector misses the wave"
assert margin.values.min() > 0, "a wheel slips under the arm"
assert painted.q[-1, 1] > 1.5, "the base does not move with the arm"
assert slips[1.02] < 1e-12, "a wheel slides with enough friction"
assert slips[0.98] > 1e-2, "no wheel slides with too little friction"
print(
    f"Shown: at 0.98 of the limit the base stays at rest, at 1.02 it slides by the formula; "
    f"the effective track of Husky is {found['Husky']:.3f} times its track; "
    f"{2_000 * predicted[3]:,.0f} of 2,000 robots slip at 2 m/s; the UR5 on the Ridgeback "
    f"needs a friction coefficient of {needed.max():.2f}."
)
