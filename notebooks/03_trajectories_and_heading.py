# %% [markdown]
# # 3 Trajectories and heading, and errors of the lecture
#
# A controller follows a *reference*: the desired configuration, velocity and acceleration at every time.
# A reference consists of a path $(x(t), y(t))$, a heading $\psi(t)$ along it, and two derivatives of
# each. The paths in this notebook are those of the lecture. Two paths take 60 s from (0, 0) through the
# via point (2, 2) to (0, 4), in m. The third path is a circle.
#
# The lecture's heading is the direction of motion, $\psi_d = \mathrm{atan2}(\dot y, \dot x)$. The
# lecture's formulas contain five errors, and each section below explains one of them. The class
# `LectureHeading` reproduces the lecture's heading with its errors, except error 3. The class `Tangent`
# implements the correct heading.

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
blue, orange, green = colour(0), colour(1), colour(2)

# %% [markdown]
# ## Two cubics through a via point
#
# The via point is reached at $t_v = 30$ s. Before and after it, each coordinate is a cubic polynomial:
#
# $$x(t) = a_0 + a_1 t + a_2 t^2 + a_3 t^3 \qquad
# x(t) = b_0 + b_1 (t - t_v) + b_2 (t - t_v)^2 + b_3 (t - t_v)^3$$
#
# The path *via stop* has a given velocity at the via point: zero. The path *via free* has no given
# velocity there. Instead, its velocity and acceleration must be continuous. Then eight equations
# determine the eight coefficients.

# %%
points = {"start": (0, 0), "via": (2, 2), "end": (0, 4)}
via_stop = CubicVia(**points, t_via=30, t_end=60, via_velocity=(0, 0))
via_free = CubicVia(**points, t_via=30, t_end=60)

figure = plt.figure(figsize=(9, 3.6), layout="constrained")
left, right = figure.subplots(1, 2, width_ratios=(1, 2))
for path, name, index in [(via_stop, "via stop", 0), (via_free, "via free", 1)]:
    position = path(t)  # [m]
    velocity = path.derivative(t, 1)  # [m/s]
    left.plot(position[:, 0], position[:, 1], color=colour(index), label=name)
    right.plot(t, np.hypot(velocity[:, 0], velocity[:, 1]), color=colour(index))
left.set(xlabel="x [m]", ylabel="y [m]", aspect="equal", title="path")
right.set(xlabel="t [s]", ylabel="speed [m/s]", title="speed along the path")
figure.legend(loc="outside lower center", ncols=2, frameon=False)
dress(left)
dress(right)

# %% [markdown]
# ## Error 1: derivatives without their factors
#
# A slide gives $b_1 + b_2 (t - t_v) + b_3 (t - t_v)^2$ as the velocity of the second cubic. This formula
# lacks the factors 2 and 3 of the derivative. The difference quotient of two nearby positions confirms
# the corrected formula.

# %%
when, h = 47.0, 1e-3  # [s]
s = when - 30
b_1 = via_free.derivative(30.0, 1)
b_2 = via_free.derivative(30.0, 2) / 2
b_3 = via_free.derivative(30.0, 3) / 6
quotient = (via_free(when + h) - via_free(when - h)) / (2 * h)
on_slide = b_1 + b_2 * s + b_3 * s**2
corrected = b_1 + 2 * b_2 * s + 3 * b_3 * s**2
print("difference quotient [m/s]:", quotient.round(6))
print("formula of slide [m/s]:   ", on_slide.round(6))
print("formula corrected [m/s]:  ", corrected.round(6))

# %% [markdown]
# ## Error 2: heading at rest
#
# At the start and at the end, the robot is at rest: $\dot x = \dot y = 0$. Programs return 0 for
# $\mathrm{atan2}(0, 0)$, although the direction is undefined. So the lecture's heading starts at 0° and
# jumps after the first sample. At the last sample it jumps back to 0°.
#
# The correct heading is the limit. Just after a rest, the robot moves in the direction of its
# acceleration. Just before a rest, it moves in the opposite direction.

# %%
lecture = LectureHeading(via_free)(t)
tangent = Tangent(via_free)(t)
psi_lecture, psi_tangent = np.degrees(lecture.q[:, 2]), np.degrees(tangent.q[:, 2])
print("  t [s]   lecture [deg]   tangent [deg]")
for k in [0, 1, 2, 598, 599, 600]:
    print(f"{t[k]:7.1f} {psi_lecture[k]:15.2f} {psi_tangent[k]:15.2f}")

# %%
figure, axes = plt.subplots(figsize=(9, 3), layout="constrained")
axes.plot(t, psi_lecture, color=orange, linewidth=3, label="lecture")
axes.plot(t, psi_tangent, "--", color=blue, label="tangent, with limits at rest")
axes.set(xlabel="t [s]", ylabel=r"$\psi$ [deg]")
axes.set_title("Heading along the path via free")
axes.legend(loc="upper left")
dress(axes)

# %% [markdown]
# ### A stop where the direction changes
#
# On the path via stop, the robot also rests at the via point. It arrives with a heading of 45° and
# leaves with 135°. Around the via point, three samples of the lecture's heading are 45°, 0° and 135°. No
# robot can follow these jumps. `Tangent` rejects this path unless the user gives a duration for the
# turn:

# %%
try:
    Tangent(via_stop)
except InvalidArgument as error:
    print(error)

# %% [markdown]
# With `turn_time=2` the robot stops, turns on the spot for 2 s, and continues. The trajectory then takes
# 62 s. The heading during the turn is a polynomial of degree five. Its value, rate and acceleration
# match the heading before and after the turn.

# %%
with_turn = Tangent(via_stop, turn_time=2)
t_turn = np.linspace(28, 34, 601)  # [s]
turning = with_turn(t_turn)
before = t_turn < 33  # the lecture's heading, for comparison
jumping = LectureHeading(via_stop)(t_turn[before])
psi_jumping = np.degrees(jumping.q[:, 2])

figure = plt.figure(figsize=(9, 4), layout="constrained")
top, bottom = figure.subplots(2, 1, sharex=True)
top.plot(t_turn[before], psi_jumping, color=orange, linewidth=3, label="lecture")
top.plot(t_turn, np.degrees(turning.q[:, 2]), color=blue, label="turn on the spot")
top.set(ylabel=r"$\psi$ [deg]", title="Heading around the via point, where the robot stops")
top.legend(loc="lower right")
bottom.plot(t_turn, turning.v[:, 2], color=blue)
bottom.set(xlabel="t [s]", ylabel=r"$\dot\psi$ [rad/s]")
dress(top)
dress(bottom)

# %% [markdown]
# ## Error 3: vertical tangents
#
# The derivative of atan2 gives the heading rate:
#
# $$\dot\psi = \frac{\dot x\,\ddot y - \dot y\,\ddot x}{\dot x^2 + \dot y^2} .$$
#
# The lecture's derivation divides by $\dot x$, and it sets the rate to 0 where $\dot x = 0$. So the rate
# is wrong where the path is exactly parallel to the y axis. The parabola below has such a point at
# $t = 0.5$ s.
#
# Rounding decides whether a program computes 0 or $10^{-17}$ for $\dot x$ there. Therefore
# `LectureHeading` does not reproduce this error: it uses the limit of the lecture's formula, which is
# the correct rate.

# %%
parabola = CubicVia(
    (0.25, 0), (0, 0.5), (0.25, 1), t_via=0.5, t_end=1,
    via_velocity=(0, 1), start_velocity=(-1, 1), end_velocity=(1, 1),
)  # fmt: skip


def rate_of_lecture(when: float) -> float:
    (dx, dy), (ddx, ddy) = parabola.derivative(when, 1), parabola.derivative(when, 2)
    return (ddy / dx - dy * ddx / dx**2) / (dy**2 / dx**2 + 1) if dx else 0.0


print("  t [s]   lecture [rad/s]   correct [rad/s]")
for when in [0.499, 0.5, 0.501]:
    rate_correct = Tangent(parabola)(when).v[2]
    print(f"{when:7.3f} {rate_of_lecture(when):17.4f} {rate_correct:17.4f}")

# %% [markdown]
# ## Error 4: the heading's acceleration
#
# Computed torque uses the desired acceleration as feedforward, including the acceleration of the
# heading. The lecture sets $\ddot\psi_d = 0$. The correct value is the derivative of the heading rate.
# The dots below are difference quotients of the rate.

# %%
between = np.arange(1, 60) + 0.5  # [s]
h = 1e-4
rate_after = Tangent(via_free)(between + h).v[:, 2]
rate_before = Tangent(via_free)(between - h).v[:, 2]
quotient = (rate_after - rate_before) / (2 * h)

figure, axes = plt.subplots(figsize=(9, 3), layout="constrained")
axes.plot(t, lecture.a[:, 2], color=orange, linewidth=3, label="lecture")
axes.plot(t, tangent.a[:, 2], color=blue, label="tangent")
axes.plot(between, quotient, ".", color=green, label="difference quotient of the rate")
axes.set(xlabel="t [s]", ylabel=r"$\ddot\psi$ [rad/s²]")
axes.set_title("Heading acceleration along the path via free")
axes.legend(loc="upper right")
dress(axes)

# %% [markdown]
# ## Error 5: the jump by 360°
#
# The third kind of path is
#
# $$x = r_x \sin(\omega_x t) \qquad y = r_y - r_y \cos(\omega_y t) .$$
#
# Equal radii and rates give a circle, and 60 s are slightly less than one revolution. Other rates give
# other Lissajous figures. A slide combines $\omega_x = 0.2$ rad/s with $\omega_y = 0.1$ rad/s. The
# lecture wraps the heading to $[0, 2\pi]$. Where the heading passes 0, the wrapped value jumps by a full
# turn.

# %%
circle = Circle(radius=3, rate=0.1, duration=60)
figure_eight = Lissajous(rx=3, ry=3, wx=0.2, wy=0.1, duration=60)
wrapped = np.degrees(LectureHeading(figure_eight)(t).q[:, 2])
unwrapped = np.degrees(Tangent(figure_eight)(t).q[:, 2])

figure = plt.figure(figsize=(9, 3.6), layout="constrained")
left, right = figure.subplots(1, 2, width_ratios=(1, 1.5))
left.plot(*circle(t).T, color=green, label="circle")
left.plot(*figure_eight(t).T, color=blue, label=r"$\omega_x = 0.2$ rad/s")
left.set(xlabel="x [m]", ylabel="y [m]", aspect="equal", title="paths")
right.plot(t, wrapped, color=orange, linewidth=3, label="lecture: wrapped")
right.plot(t, unwrapped, color=blue, label="tangent: unwrapped")
right.set(xlabel="t [s]", ylabel=r"$\psi$ [deg]")
right.set_title(r"heading for $\omega_x = 0.2$ rad/s")
right.legend(fontsize=9)
labels = left.get_legend_handles_labels()
figure.legend(*labels, loc="outside lower left", ncols=2, frameon=False)
dress(left)
dress(right)

# %% [markdown]
# The headings 0° and 360° are the same direction, but their plain difference is 360°. The lecture
# subtracts them (`plain_difference`). So its controller computes an error of a full turn and spins the
# robot. There are two corrections: the reference is unwrapped, and the library maps a heading error to
# the interval from $-\pi$ to $\pi$.

# %%
robot = MobileRobot.lecture()
subtracting = ComputedTorque(robot, difference=plain_difference)
spinning = simulate(robot, subtracting, LectureHeading(figure_eight), dt=0.1)
calm = simulate(robot, ComputedTorque(robot), Tangent(figure_eight), dt=0.1)

figure = plt.figure(figsize=(9, 4), layout="constrained")
top, bottom = figure.subplots(2, 1, sharex=True)
for run, name, index in [(spinning, "lecture", 1), (calm, "corrected", 0)]:
    top.plot(run.t, run.q[:, 2], color=colour(index), label=name)
    bottom.plot(run.t, run.u[:, 2], color=colour(index))
top.set(ylabel=r"$\psi$ [rad]", title="Heading of the robot and moment of the controller")
top.legend(loc="upper left")
bottom.set(xlabel="t [s]", ylabel="$M_z$ [N m]")
dress(top)
dress(bottom)

# %% [markdown]
# ## The complete reference
#
# Here the robot follows the path via stop under computed torque. The figure shows the simulated poses.
# At the via point, the robot turns on the spot.

# %%
rollout = simulate(robot, ComputedTorque(robot), with_turn, dt=0.1)
times = [0, 12, 20, 30, 31, 32, 42, 50, 62]  # [s]
plots.path(rollout, times=times, title="Via stop, with a turn on the spot")

# %% [markdown]
# ## The claim
#
# The lecture's heading jumps, and its rate and acceleration are wrong. `Tangent` has none of these
# errors. Between two close times, its heading changes at most by the largest rate multiplied by the
# time step.

# %%
all_paths = {
    "via stop": via_stop,
    "via free": via_free,
    "circle": circle,
    "wx = 0.2": figure_eight,
}
print("largest jump [deg]   lecture   correct")
for name, path in all_paths.items():
    trajectory = Tangent(path, turn_time=2)
    times = np.linspace(0, trajectory.duration, 6201)
    q, v, a = trajectory(times)
    jump_correct = np.abs(np.diff(q[:, 2])).max()
    jump_lecture = np.abs(np.diff(LectureHeading(path)(t).q[:, 2])).max()
    bound = 1.01 * np.abs(v[:, 2]).max() * times[1] + 1e-12
    assert jump_correct < bound, f"the correct heading jumps: {name}"
    print(f"{name:18} {np.degrees(jump_lecture):9.1f} {np.degrees(jump_correct):9.2f}")
    if path is not circle:
        assert jump_lecture > np.radians(80), f"the lecture's heading is continuous: {name}"

derivative = via_free.derivative(47.0, 1)
rate = Tangent(parabola)(0.5).v[2]
slope = Tangent(via_free)(between).a[:, 2]
assert np.abs(corrected - derivative).max() < 1e-12, "the factors are not 2 and 3"
assert np.abs(on_slide - corrected).max() > 0.01, "the slide's velocity is correct"
assert abs(rate + 2) < 1e-9, "the rate at the vertical tangent is not -2 rad/s"
assert rate_of_lecture(0.5) == 0, "the lecture's rate is not 0"
assert np.abs(quotient - slope).max() < 1e-7, "the acceleration is not the rate's derivative"
assert np.abs(spinning.u[:, 2]).max() > 2, "the lecture's robot does not spin"
assert np.abs(calm.u[:, 2]).max() < 0.1, "the corrected moment is not small"
assert rollout.max_error()[:2].max() < 1e-4, "the robot does not follow the reference"
print("Shown: the heading is correct at rest, on vertical tangents and across 360 deg.")
print("Shown: its acceleration is the derivative of its rate.")
