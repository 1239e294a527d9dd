# %% [markdown]
# # 9 When wheels slip
#
# In notebook 8 the wheels rolled, whatever force that took. The ground supplies what it can: a wheel that
# carries the load $N$ gets at most $\mu N$ along the ground, in any direction. Within that it sticks,
# beyond
# it slides, and then the force is just $\mu N$, against the sliding. That is Coulomb's law of dry friction,
#
# $$|\lambda| \le \mu N, \qquad \lambda = -\mu N \frac{s}{|s|} \ \text{ where it slides with } s \ne 0 .$$
#
# How far does a robot slide whose wheels are locked? Does it stand on a ramp? How does a base turn that
# cannot roll? When is a turn too fast, and for how many of two thousand robots? What is odometry worth
# when one wheel is one percent smaller? And what do the wheels feel of an arm?

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
# A base of 30 kg on four wheels that do not turn (here by a huge rolling resistance). It is let go at a
# speed $v$. Friction takes $\mu g$ off it per second, whatever the mass, so it slides
# $v^2 / (2 \mu g)$:

# %%
wheel = {"mass": 1.0, "spin_inertia": 0.01, "yaw_inertia": 0.006}
body = MobileRobot(30.0, 2.3, com=(0, 0, 0.2))


@law
def nothing(t, q, v, reference):
    """No torque at either motor."""
    return np.zeros(2)


def left_alone(robot, duration, v=None, engine=Engine.COMPILED):
    """Return what a robot does without torques, from rest or from velocities."""
    nowhere = FixedHeading(Hold([0.0, 0.0], duration), 0.0)
    v0 = np.zeros(robot.nv) if v is None else v
    return simulate(robot, nothing, nowhere, dt=0.01, q0=robot.rest, v0=v0, engine=engine, limit=1e9)


def locked(mu, ramp=None):
    """Return the base on locked wheels."""
    table = WheelTable.skid_steer(0.5, 0.4, 0.1, friction=WheelFriction(mu=mu, rolling=1e3), **wheel)
    return WheeledRobot(body, table, Coulomb(ramp=ramp))


speeds, coefficients = np.array([0.5, 1, 1.5, 2, 2.5, 3]), (0.3, 0.5, 0.8)
slid = {mu: [] for mu in coefficients}
for mu in coefficients:
    robot = locked(mu)
    for speed in speeds:
        run = left_alone(robot, 1.2, np.array([speed, *np.zeros(robot.nv - 1)]))
        slid[mu].append(run.q[-1, 0])
off_by = max(np.abs(slid[mu] - speeds**2 / (2 * mu * g)).max() for mu in coefficients)
print(f"largest difference from v^2 / (2 mu g): {1e3 * off_by:.3f} mm, with steps of 10 ms")

figure, axes = plt.subplots(figsize=(6.5, 3.4), layout="constrained")
fine = np.linspace(0, 3, 100)
for k, mu in enumerate(coefficients):
    axes.plot(fine, fine**2 / (2 * mu * g), ("-", "--", ":")[k], color=colour(k))
    axes.plot(speeds, slid[mu], "os^"[k], color=colour(k), label=rf"$\mu$ = {mu}")
axes.set(xlabel="speed at which the wheels lock [m/s]", ylabel="distance slid [m]")
axes.set_title(r"Simulated, and $v^2 / (2 \mu g)$", fontsize=11)
axes.legend(frameon=False)
dress(axes)

# %% [markdown]
# ## A ramp
#
# On a ramp of angle $\alpha$ weight pulls with $m g \sin\alpha$ and friction holds up to
# $\mu m g \cos\alpha$. At $\tan\alpha = 0.98\,\mu$ it has to stand, for good; at $1.02\,\mu$ it must slide,
# with $g (\sin\alpha - \mu \cos\alpha)$ exactly. That is harder for a simulation than it sounds: friction
# that is smoothed creeps down any slope.

# %%
mu, stands, slides = 0.5, np.arctan(0.98 * 0.5), np.arctan(1.02 * 0.5)
still = left_alone(locked(mu, Ramp(stands)), 10.0)
moving = left_alone(locked(mu, Ramp(slides)), 10.0)
crept = np.abs(still.q).max()
down = g * (np.sin(slides) - mu * np.cos(slides))
off_ramp = np.abs(moving.v[:, 0] + down * moving.t).max()
print(f"at 0.98 of the limit it moved {crept:.0e} m in {len(still) - 1:,} steps")
print(f"at 1.02 its speed is that of the formula within {off_ramp:.0e} m/s, at the end {down * 10:.2f} m/s")

# %% [markdown]
# ## A base that turns by sliding
#
# Husky and Jackal have four wheels that point forward, those of a side on one gear train. Such a base cannot
# turn unless wheels slide sideways. How fast does it turn where the left wheels roll backwards and the
# right ones forward, each at the surface speed $u$? Rolling would say $\omega = u / b$, with $b$ half the
# track. It is less, as if the track were wider. At each wheel friction points against its own sliding, which
# is $u - \omega b$ along and $\omega l_x$ across. In a steady turn the four have no moment about the middle,
# $b\,(u - \omega b) = l_x\,\omega l_x$, and so
#
# $$\frac{\text{effective track}}{\text{track}} = \frac{u}{\omega b} = 1 + \left(\frac{l_x}{b}\right)^2$$
#
# with $l_x$ half the wheelbase, for equal loads, *whatever the friction*. Their makers' controllers have this
# number as a parameter, found by trying: `wheel_separation_multiplier` (husky/husky dff7c81,
# jackal/jackal c6ab6ca).


# %%
def effective_track(robot, table):
    """Return the track that a base seems to have in a slow turn in place, as a multiple of its own."""
    base, surface = WheeledRobot(robot, table), 0.02  # [m/s] of the wheels
    turning = surface / table.wheels[0].radius * np.array([-1.0, 1.0, -1.0, 1.0])
    run = left_alone(base, 0.3, np.concatenate([np.zeros(3), turning]), Engine.PYTHON)
    radius, half = table.wheels[0].radius, table.wheels[0].y
    return run.v[-1, 4] * radius / run.v[-1, 2] / half


def skidding(wheelbase, track, radius, mu):
    """Return four wheels that keep their rates, whatever the ground does: their motors have flywheels."""
    kept = {**wheel, "friction": WheelFriction(mu=mu, rolling=0.0), "motor": Motor(rotor_inertia=1e6)}
    return WheelTable.skid_steer(wheelbase, track, radius, **kept)


frictions, shapes = (0.2, 0.5, 1.0), np.array([0.5, 1.0, 1.5])
seen = {
    mu: [effective_track(body, skidding(0.4 * shape, 0.4, 0.1, mu)) for shape in shapes] for mu in frictions
}
bases = {
    # mass, yaw inertia, height of the centre of mass; wheelbase, track, radius; multiplier configured
    "Husky": (MobileRobot(56.58, 2.5, com=(0, 0, 0.189)), (0.512, 0.5708, 0.1651), 1.875),
    "Jackal": (MobileRobot(18.43, 0.5, com=(0, 0, 0.1)), (0.262, 0.3756, 0.098), 1.5),
}
found = {name: effective_track(robot, skidding(*size, 0.6)) for name, (robot, size, _) in bases.items()}
for name, (_, size, configured) in bases.items():
    rule = 1 + (size[0] / size[1]) ** 2
    print(f"{name:6} simulated {found[name]:.3f}, 1 + (lx/b)^2 = {rule:.3f}, configured {configured:.3f}")
ahead = effective_track(MobileRobot(30.0, 2.3, com=(0.08, 0, 0.2)), skidding(0.4, 0.4, 0.1, 0.6))
print(f"a square base, its mass in the middle {seen[0.5][1]:.2f}, 8 cm ahead of it {ahead:.2f}")

figure, axes = plt.subplots(figsize=(7, 3.8), layout="constrained")
fine = np.linspace(0.3, 1.7, 100)
axes.plot(fine, 1 + fine**2, color=INK, linewidth=1.2, label="$1 + (l_x/b)^2$")
for k, mu in enumerate(frictions):
    marker = {"marker": "os^"[k], "markersize": (12, 8, 4)[k], "linestyle": ""}
    axes.plot(shapes, seen[mu], color=colour(k), label=rf"simulated, $\mu$ = {mu}", **marker)
for name, (_, size, configured) in bases.items():
    axes.plot(size[0] / size[1], configured, "x", color=INK, markersize=9, markeredgewidth=2)
    axes.annotate(name, (size[0] / size[1], configured), (-10, 10), textcoords="offset points", ha="right")
axes.plot([], [], "x", color=INK, markeredgewidth=2, label="as their makers configure it")
axes.set(xlabel="wheelbase / track, $l_x / b$ [-]", ylabel="effective track / track [-]")
axes.legend(frameon=False)
dress(axes)

# %% [markdown]
# The markers of three frictions lie on each other. Husky and Jackal are configured within 4 % of the rule;
# what makes the rest, tyres that give way, loads or floors, cannot be told from here. Loads do matter: with
# the mass 8 cm ahead, the front wheels carry so much that they stick, and the base turns about their
# axle's middle, the rear wheels dragged sideways.
#
# ## A turn too fast
#
# A differential drive of 27 kg, half of its weight on the two wheels, the rest on casters. It drives an
# ellipse, whose ends are tight. While it rolls, the model of notebook 8 tells the force of the ground at the
# wheels, and `contact_loads` what they carry; what is left is the **slip margin**, here of the axle, since
# rolling tells the sum of the sideways forces alone:
#
# $$\sum_i \sqrt{(\mu N_i)^2 - \lambda_{i,\mathrm{along}}^2} \;-\; |Y|$$
#
# Before anything is driven, `max_path_speed` tells how fast the whole path can be taken on ground with
# $\mu = 0.4$, and what gives way first. Then it is driven, a little slower than that and a little faster, on
# the same ground, by tyres that give way by 0.1 mm/s per newton before they slide, as tyres do: that decides
# how the two share the force across.

# %%
places, limited = [(0.25, 0), (-0.25, 0)], Motor(torque_limit=6.0)
driven = WheelTable.differential(0.5, 0.1, supports=places, motor=limited, **wheel)
light = MobileRobot(27.0, 2.3, com=(0, 0, 0.15))


def on(friction):
    """Return the table with other tyres."""
    return WheelTable.differential(0.5, 0.1, supports=places, motor=limited, friction=friction, **wheel)


rolling = WheeledRobot(light, on(WheelFriction(mu=0.4)))
slippery = WheeledRobot(light, on(WheelFriction(mu=0.4, slip=1e-4)), Coulomb())


def ellipse(faster):
    """Return an ellipse of 4 m by 2 m, taken so many times as fast as in 4 pi seconds."""
    whole = round(4 * np.pi / faster, 2)
    return Tangent(Lissajous(2, 1, 0.5 * faster, 0.5 * faster, whole))


limit = max_path_speed(rolling, ellipse(1))
print(f"up to {limit.factor:.3f} times as fast, {limit.value:.2f} m/s; beyond, {limit.what}")
firmware = WheelSpeed(UnicycleTracking(b=0.3), rolling, kp=3, ki=10)
turns, margins = {}, {}
for share in (0.97, 1.1):
    quick = ellipse(share * limit.factor)
    name = f"{share:g} of the limit"
    margins[name] = simulate(rolling, firmware, quick, dt=0.01, engine=Engine.COMPILED)
    turns[name] = simulate(slippery, firmware, quick, dt=0.01, engine=Engine.COMPILED)
    slid_at = turns[name].metrics()["slip"][1]
    left_over = slip_margins(margins[name]).values.min()
    print(f"{name}: if it rolled, margin {left_over:6.2f} N; on the ground, slip {slid_at.max():.1g} m/s")

# %%
figure, (left, right) = plt.subplots(1, 2, figsize=(11, 3.8), layout="constrained")
for k, (name, run) in enumerate(turns.items()):
    style = {"color": colour(k), "linestyle": ("-", "--")[k], "linewidth": 2.2, "label": name}
    left.plot(run.t, slip_margins(margins[name]).values[:, 0], **style)
    right.plot(*run.q[:, :2].T, **style)
left.axhline(0, color=INK, linewidth=1)
left.set(xlabel="t [s]", ylabel="slip margin of the axle [N]", title="If it rolled")
right.plot(*run.reference.q[:, :2].T, color=INK, linewidth=1, label="desired")
right.set(xlabel="x [m]", ylabel="y [m]", title="On the ground", aspect="equal")
figure.legend(*right.get_legend_handles_labels(), loc="outside lower center", ncols=3, frameon=False)
for axes in (left, right):
    dress(axes)

# %%
plots.friction(turns["0.97 of the limit"], title="0.97 of the limit: force in the friction circle")

# %%
plots.friction(turns["1.1 of the limit"], title="1.1 of the limit: force in the friction circle")

# %% [markdown]
# Below the limit the inner wheel, which carries less in a turn, is at the rim of its friction circle at the
# tight ends and creeps by millimetres per second; the outer one holds the rest, just so. Above it both
# slide: the margin was negative, and nothing else can hold. A wheel that slides across has nothing left
# along. So its motor spins it up instead of driving the robot, which leaves the path at the first tight end.
#
# ## How many of two thousand?
#
# Friction is hardly known. Let $\mu$ be anything between 0.2 and 0.8, and the centre of mass between 0.1
# and 0.2 m high, for two thousand robots on a circle of 2 m. Those whose margin becomes negative would slip.
# A second ensemble lets them: on `Coulomb` ground, those slipped that slid faster than 1 mm/s. With
# pencil and paper: half of the weight on the wheels gives $v^2 / R = \mu g / 2$.

# %%
judged = WheeledRobot(light, driven)
uncertain = {
    "left.friction.mu": Uniform(0.2, 0.8),
    "right.friction.mu": SameAs("left.friction.mu"),
    "com.z": Uniform(0.1, 0.2),
}
paces = np.array([1.4, 1.6, 1.8, 2.0, 2.2, 2.4, 2.6, 2.8])
told, did, agreed = [], [], []
for pace in paces:
    circle = Tangent(Circle(2, pace / 2, 1))
    options = {"n": 2_000, "spread": uncertain, "dt": 0.01}
    would = ensemble(judged, Backstepping(UnicycleTracking(), judged), circle, **options)
    told.append(np.mean(would.largest("slip margin") < 0))
    if pace in (1.6, 2.0, 2.4):
        ground = WheeledRobot(light, driven, Coulomb())
        slipped = ensemble(ground, Backstepping(UnicycleTracking(), judged), circle, **options)
        did.append(np.mean(slipped.largest("slip") > 1e-3))
        agreed.append(np.mean((slipped.largest("slip") > 1e-3) == (would.largest("slip margin") < 0)))
by_pencil = np.clip((2 * paces**2 / (2 * g) - 0.2) / 0.6, 0, 1)
for pace, share, pencil in zip(paces, told, by_pencil, strict=True):
    print(f"at {pace} m/s {2_000 * share:5,.0f} of 2,000 would slip, by the rule {2_000 * pencil:5,.0f}")
print(f"rolling and slipping agree on {100 * min(agreed):.2f} % of the robots and more")

figure, axes = plt.subplots(figsize=(6.5, 3.4), layout="constrained")
fine = np.linspace(1.3, 2.9, 100)
axes.plot(fine, 100 * np.clip((fine**2 / g - 0.2) / 0.6, 0, 1), color=INK, label=r"$v^2 / R = \mu g / 2$")
axes.plot(paces, 100 * np.array(told), "o", color=colour(0), markersize=9, label="negative margin, rolling")
axes.plot([1.6, 2.0, 2.4], 100 * np.array(did), "^", color=colour(1), label="slid on the ground")
axes.set(xlabel="speed on a circle of 2 m [m/s]", ylabel="robots that slip [%]")
axes.legend(frameon=False)
dress(axes)

# %% [markdown]
# ## What is odometry worth?
#
# A wheel need not slip to mislead. `OdometryFeedback` tells its controller the pose that follows from what
# the
# wheels have turned, by the table that it believes. Let the left wheel be 1 % smaller than believed. The
# robot drives 10 m straight on, as it thinks. By pencil: the left side makes 1 % less way, so the
# heading turns by $0.01 / 0.5$ rad per metre (the track has 0.5 m), and 10 m on the robot is
# $\frac{1}{2} \cdot 0.02 \cdot 10^2 = 1$ m to the left.

# %%
straight = Tangent(RestToRest((0, 0), (10, 0), duration=20))
believes = OdometryFeedback(Backstepping(UnicycleTracking(), judged), driven)
smaller = parts.replace(judged, {"table.wheels.left.radius": 0.099})
misled = simulate(smaller, believes, straight, dt=0.02, engine=Engine.COMPILED)
aside = misled.q[-1, 1]
thought = misled.signals["believed_pose"].values[-1]
print(f"it believes to be at {thought[0]:.3f} m, {1e3 * thought[1]:.3f} mm aside,")
print(f"and is at {misled.q[-1, 0]:.3f} m, {aside:.3f} m aside, its heading off by {misled.q[-1, 2]:.3f} rad")
plots.odometry(misled, title="Straight on, with a left wheel that is 1 % smaller than believed")

# %% [markdown]
# Two thousand robots whose two wheels are each off by 0.5 % (standard deviation), say. Their difference
# has $\sqrt 2$ times that, and half of it times $10^2$ over the track is how far they end aside:

# %%
fleet = ensemble(
    judged,
    believes,
    straight,
    n=2_000,
    spread={"left.radius": Normal(0.1, 0.0005), "right.radius": Normal(0.1, 0.0005)},
    dt=0.02,
)
shares = {0.5: 0.6745, 0.9: 1.6449, 0.99: 2.5758}  # of a normal distribution: standard deviations
strayed = {share: fleet.error_quantile(share).distance for share in shares}
ruled = {share: k * np.sqrt(2) * 0.005 / 0.5 * 100 / 2 for share, k in shares.items()}
for share in shares:
    print(f"{100 * share:g} % stray by {strayed[share]:.2f} m at most, by the rule {ruled[share]:.2f} m")

# %% [markdown]
# After 10 m half of them are half a metre off, without a single slip. That is why robots look around.
#
# ## With an arm on it
#
# A UR5 on a Ridgeback, a base on mecanum wheels (its numbers are those of its file, ridgeback/ridgeback
# f38b789, with the wheels locked; its front axle hangs on a rocker, which is held here). The hand draws
# a
# wave on a wall, 2 m long in 5 s, longer than the arm. `solve_inverse_kinematics` finds a motion of base and
# arm together,
# `EndEffectorTracking` follows the wave by the torques of ten motors: four wheels, six joints. The
# friction is taken as 0.4.

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
ridgeback = MobileRobot(195.038, 11.7683, com=(0.01017, 0.0017, 0.09031), size=(0.96, 0.793, 0.31))
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
print(
    f"the base goes {painted.q[-1, 1]:.2f} m sideways, the hand is off by {1e3 * missed.max():.2f} mm at most"
)
for name, least, load in zip(
    margin.names, margin.values.min(axis=0), carried.values.min(axis=0), strict=True
):
    print(f"{name:12} carries at least {load:3.0f} N, slip margin at least {least:3.0f} N")
print(f"friction needed: {needed.max():.3f}; tip-over margin {100 * tip_over_margin(painted).min():.0f} cm")

# %%
figure, (left, right) = plt.subplots(1, 2, figsize=(11, 3.6), layout="constrained")
left.plot(*target(painted.t).pose[:, 1:3, 3].T, color=INK, linewidth=1, zorder=4, label="target")
left.plot(*at[:, 1:].T, color=colour(0), linewidth=4, label="hand")
left.plot(
    painted.q[:, 1],
    0 * painted.t + 0.35,
    "--",
    color=colour(1),
    linewidth=2,
    label="middle of the base, y alone",
)
left.set(xlabel="y [m]", ylabel="z [m]", title="The wall", ylim=(0.3, 0.75))
left.legend(frameon=False, loc="lower right", ncols=3)
for k, name in enumerate(margin.names):
    dashes = ("-", "--", ":", "-.")[k]
    right.plot(
        painted.t, margin.values[:, k], dashes, color=colour(k), linewidth=2, label=name.replace("_", " ")
    )
right.set(xlabel="t [s]", ylabel="slip margin [N]", title="What friction is left at the wheels")
right.set_ylim(bottom=0)
right.legend(frameon=False, ncols=2)
for axes in (left, right):
    dress(axes)

# %% [markdown]
# The arm stands ahead of the middle, so the rear wheels carry less, and theirs are the small margins. Is
# that friction right? On ground that slips, with a little more than the friction that is needed, no
# wheel may slide; with a little less one must.

# %%
follower = ComputedTorque(painter, kp=100, kd=20)
rolled = simulate(painter, follower, motion, dt=0.01, engine=Engine.COMPILED)
least = (np.abs(slip_margins(rolled).along) / contact_loads(rolled).values).max()
slips = {}
for share in (1.02, 0.98, 0.6):
    floor = WheeledRobot(painter.robot, rollers, Coulomb(share * least))
    tried = simulate(floor, follower, motion, dt=0.01, engine=Engine.COMPILED)
    slips[share] = tried.metrics()["slip"][1].max()
    off = painter.robot.frame_pose(tried.q[:, :9])[:, :3, 3] - target(tried.t).pose[:, :3, 3]
    off = np.linalg.norm(off, axis=1).max()
    often = 100 * tried.signals["slides"].values.any(axis=1).mean()
    print(f"{share:4} of the friction needed: slides {often:4.1f} % of the time, hand off {1e3 * off:.1f} mm")

# %% [markdown]
# One wheel that slides for a moment is made up for by the others, and by feedback. Where friction is far
# from enough, the robot is lost.
#
# ## The claim
#
# Dry friction holds without creeping and slides by the book; a skid-steer base turns as if its track were
# wider by $1 + (l_x / b)^2$, whatever the friction; slip margins of a model that rolls tell where a robot
# on real ground will slide, of one, of two thousand, and with an arm on it; and odometry is worth what the
# wheels' radii are.

# %%
assert off_by < 5e-4, "locked wheels slide another distance"
assert crept < 1e-14, "what friction can hold creeps"
assert off_ramp < 1e-11, "what friction cannot hold accelerates otherwise"
for mu in frictions:
    assert np.allclose(seen[mu], 1 + shapes**2, rtol=1e-4), "the effective track depends on more"
for name, (_, size, configured) in bases.items():
    assert abs(found[name] / (1 + (size[0] / size[1]) ** 2) - 1) < 0.005, "another track is effective"
    assert abs(found[name] / configured - 1) < 0.045, "makers configure something else"
assert abs(ahead - 1) < 1e-3, "the front wheels do not stick under a mass ahead"
assert limit.what == "left + right slip", "something else gives way"
slow, quick = (run.metrics()["slip"][1].max() for run in turns.values())
assert slow < 0.02, "it slides below the limit"
assert not turns["0.97 of the limit"].signals["slides"].values.all(axis=1).any(), "both wheels slide"
assert quick > 1, "it does not slide above the limit"
first = next(iter(turns.values())).max_error()[:2].max()
assert first < 0.05, "it errs below the limit"
least_margins = [slip_margins(run).values.min() for run in margins.values()]
assert least_margins[0] > 0 > least_margins[1], "the margins tell otherwise"
assert np.abs(np.array(told) - by_pencil).max() < 0.02, "the rule for one is off for many"
assert min(agreed) > 0.995, "margins do not tell who slips"
assert abs(aside - 1) < 0.02, "odometry errs otherwise"
assert np.hypot(thought[0] - 10, thought[1]) < 5e-3, "the robot knows better"
assert all(abs(strayed[share] / ruled[share] - 1) < 0.05 for share in shares), "the fleet strays otherwise"
assert missed.max() < 1e-3, "the hand is off"
assert margin.values.min() > 0, "a wheel slips under the arm"
assert painted.q[-1, 1] > 1.5, "the base does not help"
assert slips[1.02] < 1e-12, "a wheel slides that need not"
assert slips[0.98] > 1e-2, "no wheel slides that must"
print(
    f"Shown: at 0.98 of the limit nothing moves, at 1.02 it slides as the formula says; Husky turns as if "
    f"{found['Husky']:.2f} times as wide; {2_000 * told[3]:,.0f} of 2,000 robots slip at 2 m/s; the UR5 on "
    f"the Ridgeback needs a friction of {needed.max():.2f}."
)
