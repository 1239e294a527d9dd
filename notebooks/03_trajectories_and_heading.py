# %% [markdown]
# # 3 Trajectories and heading, and what goes wrong in the lecture's version
#
# A controller follows a *reference*: where to be and how to move, at every time. It is made of a path
# $(x(t), y(t))$ and a heading $\psi(t)$ along it, with two derivatives of each. The paths here are the
# lecture's: 60 s from (0, 0) through the via point (2, 2) to (0, 4), all in m, and a circle.
#
# The lecture takes the heading along the line of sight, $\psi_d = \mathrm{atan2}(\dot y, \dot x)$. That
# is a good idea with five traps in it. `LectureHeading` has the lecture's version, traps included;
# `Tangent` has it right.

# %%
import matplotlib.pyplot as plt
import numpy as np

from pinmobile import (
    Circle,
    ComputedTorque,
    CubicVia,
    InvalidArgument,
    Lissajous,
    MobileRobot,
    Tangent,
    plots,
    simulate,
)
from pinmobile.controllers import plain_difference
from pinmobile.plots.style import colour, dress
from pinmobile.trajectories import LectureHeading

t = np.arange(601) * 0.1  # 0 to 60 s in steps of 0.1 s

# %% [markdown]
# ## Two cubics through a via point
#
# Before the via point, at $t_v = 30$ s, and after it, each coordinate is a cubic:
#
# $$x(t) = a_0 + a_1 t + a_2 t^2 + a_3 t^3 \qquad
# x(t) = b_0 + b_1 (t - t_v) + b_2 (t - t_v)^2 + b_3 (t - t_v)^3$$
#
# Either the velocity at the via point is given, here as zero (*via stop*), or it is left free (*via
# free*). Then the velocity and the acceleration must be continuous, and eight equations give the eight
# coefficients.

# %%
via_stop = CubicVia((0, 0), (2, 2), (0, 4), t_via=30, t_end=60, via_velocity=(0, 0))
via_free = CubicVia((0, 0), (2, 2), (0, 4), t_via=30, t_end=60)

figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.6), layout="constrained", width_ratios=(1, 2))
for path, name, index in [(via_stop, "via stop", 0), (via_free, "via free", 1)]:
    position = path(t)  # [m]
    velocity = path.derivative(t, 1)  # [m/s]
    left.plot(position[:, 0], position[:, 1], color=colour(index), label=name)
    right.plot(t, np.hypot(velocity[:, 0], velocity[:, 1]), color=colour(index))
left.set(xlabel="x [m]", ylabel="y [m]", aspect="equal", title="path")
right.set(xlabel="t [s]", ylabel="speed [m/s]", title="speed along it")
figure.legend(loc="outside lower center", ncols=2, frameon=False)
dress(left)
dress(right)

# %% [markdown]
# ## Trap 1: derivatives without their factors
#
# A slide has $b_1 + b_2 (t - t_v) + b_3 (t - t_v)^2$ as the velocity of the second cubic. The factors 2
# and 3 are missing. The velocity that is measured between two nearby positions shows which one is right.

# %%
when, h = 47.0, 1e-3  # [s]
s = when - 30
b_1 = via_free.derivative(30.0, 1)
b_2 = via_free.derivative(30.0, 2) / 2
b_3 = via_free.derivative(30.0, 3) / 6
measured = (via_free(when + h) - via_free(when - h)) / (2 * h)
on_slide = b_1 + b_2 * s + b_3 * s**2
put_right = b_1 + 2 * b_2 * s + 3 * b_3 * s**2
print("measured [m/s]: ", measured.round(6))
print("slide [m/s]:    ", on_slide.round(6))
print("put right [m/s]:", put_right.round(6))

# %% [markdown]
# ## Trap 2: heading at rest
#
# At the start and at the end the robot rests: $\dot x = \dot y = 0$. The computer's answer to
# $\mathrm{atan2}(0, 0)$ is 0, which is no direction at all. So the lecture's heading starts at 0° and
# jumps after the first sample, and at the last sample it jumps back.
#
# The right answer is the limit: just after a rest the robot moves along its acceleration, just before a
# rest against it.

# %%
lecture = LectureHeading(via_free)(t)
tangent = Tangent(via_free)(t)
print("  t [s]   lecture [deg]   tangent [deg]")
for k in [0, 1, 2, 598, 599, 600]:
    print(f"{t[k]:7.1f} {np.degrees(lecture.q[k, 2]):15.2f} {np.degrees(tangent.q[k, 2]):15.2f}")

# %%
figure, axes = plt.subplots(figsize=(9, 3), layout="constrained")
axes.plot(t, np.degrees(lecture.q[:, 2]), color=colour(1), linewidth=3, label="lecture")
axes.plot(t, np.degrees(tangent.q[:, 2]), "--", color=colour(0), label="tangent, with the limits")
axes.set(xlabel="t [s]", ylabel=r"$\psi$ [deg]", title="Heading along the via-free path")
axes.legend(loc="upper left")
dress(axes)

# %% [markdown]
# ### A stop where the direction changes
#
# On the via-stop path the robot rests at the via point, too. It arrives at 45° and leaves at 135°. The
# lecture's reference has 45° before, 0° at the via point itself, and 135° after it, in three samples. No
# robot can follow that. A path that asks for it is refused, until it is said how long the turn may take:

# %%
try:
    Tangent(via_stop)
except InvalidArgument as error:
    print(error)

# %% [markdown]
# With `turn_time=2` the robot stops, turns on the spot for 2 s, and goes on. The trajectory then takes
# 62 s. The turn is a polynomial of degree five that meets the heading, its rate and its acceleration on
# both sides.

# %%
with_turn = Tangent(via_stop, turn_time=2)
t_turn = np.linspace(28, 34, 601)  # [s]
turning = with_turn(t_turn)
before = t_turn < 33  # the lecture's heading, for comparison
jumping = LectureHeading(via_stop)(t_turn[before])

figure, (top, bottom) = plt.subplots(2, 1, figsize=(9, 4), sharex=True, layout="constrained")
top.plot(t_turn[before], np.degrees(jumping.q[:, 2]), color=colour(1), linewidth=3, label="lecture")
top.plot(t_turn, np.degrees(turning.q[:, 2]), color=colour(0), label="turn on the spot")
top.set(ylabel=r"$\psi$ [deg]", title="Around the via point, where the robot stops")
top.legend(loc="lower right")
bottom.plot(t_turn, turning.v[:, 2], color=colour(0))
bottom.set(xlabel="t [s]", ylabel=r"$\dot\psi$ [rad/s]")
dress(top)
dress(bottom)

# %% [markdown]
# ## Trap 3: vertical tangents
#
# The heading rate, from the derivative of atan2, is
#
# $$\dot\psi = \frac{\dot x\,\ddot y - \dot y\,\ddot x}{\dot x^2 + \dot y^2} .$$
#
# The lecture divides by $\dot x$ on the way there, and sets the rate to 0 where $\dot x = 0$. So the
# rate is lost wherever the path runs exactly along y. Here is a parabola that does so at $t = 0.5$ s.
# (Whether a computer's $\dot x$ is 0 or $10^{-17}$ there is rounding's choice, so `LectureHeading` takes
# the limit of the lecture's formula, which is the right rate.)

# %%
parabola = CubicVia(
    (0.25, 0), (0, 0.5), (0.25, 1), t_via=0.5, t_end=1,
    via_velocity=(0, 1), start_velocity=(-1, 1), end_velocity=(1, 1),
)  # fmt: skip


def by_the_lecture(when: float) -> float:
    (dx, dy), (ddx, ddy) = parabola.derivative(when, 1), parabola.derivative(when, 2)
    return (ddy / dx - dy * ddx / dx**2) / (dy**2 / dx**2 + 1) if dx else 0.0


for when in [0.499, 0.5, 0.501]:
    rate_lecture = by_the_lecture(when)
    rate_right = Tangent(parabola)(when).v[2]
    print(f"t = {when:.3f} s: lecture {rate_lecture:7.4f} rad/s, right {rate_right:7.4f} rad/s")

# %% [markdown]
# ## Trap 4: the heading's acceleration
#
# Computed torque feeds the desired acceleration forward, that of the heading included. The lecture takes
# $\ddot\psi_d = 0$. It is the derivative of the rate, which the dots below measure.

# %%
between = np.arange(1, 60) + 0.5  # [s]
h = 1e-4
measured = (Tangent(via_free)(between + h).v[:, 2] - Tangent(via_free)(between - h).v[:, 2]) / (2 * h)

figure, axes = plt.subplots(figsize=(9, 3), layout="constrained")
axes.plot(t, lecture.a[:, 2], color=colour(1), linewidth=3, label="lecture")
axes.plot(t, tangent.a[:, 2], color=colour(0), label="tangent")
axes.plot(between, measured, ".", color=colour(2), label="measured from the rate")
axes.set(xlabel="t [s]", ylabel=r"$\ddot\psi$ [rad/s²]", title="Heading acceleration along the via-free path")
axes.legend(loc="upper right")
dress(axes)

# %% [markdown]
# ## Trap 5: the wrap
#
# The third kind of path is
#
# $$x = r_x \sin(\omega_x t) \qquad y = r_y - r_y \cos(\omega_y t) :$$
#
# a circle for equal radii and rates (60 s are a little less than one round), other Lissajous figures for
# other rates. A slide has $\omega_x = 0.2$ rad/s beside $\omega_y = 0.1$ rad/s. The lecture wraps the
# heading to $[0, 2\pi]$; where it passes 0, it jumps by a whole turn.

# %%
circle = Circle(radius=3, rate=0.1, duration=60)
figure_eight = Lissajous(rx=3, ry=3, wx=0.2, wy=0.1, duration=60)
wrapped = LectureHeading(figure_eight)(t)
unwrapped = Tangent(figure_eight)(t)

figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.6), layout="constrained", width_ratios=(1, 1.5))
left.plot(circle(t)[:, 0], circle(t)[:, 1], color=colour(2), label="circle")
left.plot(figure_eight(t)[:, 0], figure_eight(t)[:, 1], color=colour(0), label=r"$\omega_x = 0.2$ rad/s")
left.set(xlabel="x [m]", ylabel="y [m]", aspect="equal", title="paths")
right.plot(t, np.degrees(wrapped.q[:, 2]), color=colour(1), linewidth=3, label="lecture: wrapped")
right.plot(t, np.degrees(unwrapped.q[:, 2]), color=colour(0), label="tangent: unwrapped")
right.set(xlabel="t [s]", ylabel=r"$\psi$ [deg]", title=r"heading for $\omega_x = 0.2$ rad/s")
right.legend(fontsize=9)
figure.legend(*left.get_legend_handles_labels(), loc="outside lower left", ncols=2, frameon=False)
dress(left)
dress(right)

# %% [markdown]
# Headings of 0° and 360° are the same, but their difference is not zero, unless it is taken on the
# circle. The lecture subtracts (`plain_difference`), so the controller sees an error of a whole turn and
# makes the robot spin. Put right, the reference is unwrapped and the error is taken on the circle.

# %%
robot = MobileRobot.lecture()
spun = simulate(
    robot, ComputedTorque(robot, difference=plain_difference), LectureHeading(figure_eight), dt=0.1
)
calm = simulate(robot, ComputedTorque(robot), Tangent(figure_eight), dt=0.1)

figure, (top, bottom) = plt.subplots(2, 1, figsize=(9, 4), sharex=True, layout="constrained")
for run, name, index in [(spun, "lecture", 1), (calm, "put right", 0)]:
    top.plot(run.t, run.q[:, 2], color=colour(index), label=name)
    bottom.plot(run.t, run.u[:, 2], color=colour(index))
top.set(ylabel=r"$\psi$ [rad]", title="What the robot does")
top.legend(loc="upper left")
bottom.set(xlabel="t [s]", ylabel="$M_z$ [N m]")
dress(top)
dress(bottom)

# %% [markdown]
# ## All together
#
# The via-stop path with computed torque, and the robot where it really is. At the via point it turns on
# the spot.

# %%
rollout = simulate(robot, ComputedTorque(robot), with_turn, dt=0.1)
plots.path(rollout, times=[0, 12, 20, 30, 31, 32, 42, 50, 62], title="Via stop, with a turn on the spot")

# %% [markdown]
# ## The claim
#
# The lecture's heading jumps and loses its rate and its acceleration; `Tangent` does none of this:
# between two close times the heading moves no further than its rate takes it.

# %%
all_paths = {"via stop": via_stop, "via free": via_free, "circle": circle, "wx = 0.2": figure_eight}
print("largest jump [deg]   lecture   right")
for name, path in all_paths.items():
    trajectory = Tangent(path, turn_time=2)
    times = np.linspace(0, trajectory.duration, 6201)
    q, v, a = trajectory(times)
    step = times[1]
    jump_right = np.abs(np.diff(q[:, 2])).max()
    jump_lecture = np.abs(np.diff(LectureHeading(path)(t).q[:, 2])).max()
    fastest = np.abs(v[:, 2]).max()
    assert jump_right < 1.01 * fastest * step + 1e-12, f"the heading jumps: {name}"
    print(f"{name:18} {np.degrees(jump_lecture):9.1f} {np.degrees(jump_right):7.2f}")
    if path is not circle:
        assert jump_lecture > np.radians(80), f"the lecture's heading does not jump: {name}"

assert np.abs(put_right - via_free.derivative(47.0, 1)).max() < 1e-12, "the factors are not 2 and 3"
assert np.abs(on_slide - put_right).max() > 0.01, "the slide's velocity is right after all"
assert abs(Tangent(parabola)(0.5).v[2] + 2) < 1e-9, "the rate at the vertical tangent is not -2 rad/s"
assert by_the_lecture(0.5) == 0, "the lecture's rate is not lost"
assert np.abs(measured - Tangent(via_free)(between).a[:, 2]).max() < 1e-7, "not the derivative of the rate"
assert np.abs(spun.u[:, 2]).max() > 2, "the lecture's robot does not spin"
assert np.abs(calm.u[:, 2]).max() < 0.1, "the moment is not small"
assert rollout.max_error()[:2].max() < 1e-4, "the robot does not follow"
print("Shown: the heading is right at rest, on vertical tangents, across 360 deg, and in its acceleration.")
