# %% [markdown]
# # 10 From a log to parameters
#
# Notebook 6 asked how wrong the model may be. How wrong it is, only the robot can say: from a log of where
# it was, $q = (x, y, \psi)$, and what it was pushed with, $\tau = (F_x, F_y, M_z)$. Along the body's axes,
# with the twist $(u, w, r)$ of its origin, the lecture's equations with friction are
#
# $$
# \begin{aligned}
# F_u &= m\,a_u - m x_{bc}\,r^2 - m y_{bc}\,\dot r + c_u u + f_u\,\mathrm{sgn}\,u \\
# F_w &= m\,a_w + m x_{bc}\,\dot r - m y_{bc}\,r^2 + c_w w + f_w\,\mathrm{sgn}\,w \\
# M_z &= m x_{bc}\,a_w - m y_{bc}\,a_u + I\,\dot r + c_r r + f_r\,\mathrm{sgn}\,r
# \end{aligned}
# \qquad a_u = \dot u - r w,\quad a_w = \dot w + r u
# $$
#
# They are *linear* in ten numbers: $m$, $m x_{bc}$, $m y_{bc}$, $I$ and six of friction. A log of a minute
# has thousands of such rows. Is that not a line of `lstsq`? Three things stand in the way: a motion may not
# tell, poses come late, and an interval is easier printed than kept.

# %%
from functools import partial

import matplotlib.pyplot as plt
import numpy as np
from scipy.signal import butter, sosfiltfilt

from pinmobile import (
    Circle,
    ComputedTorque,
    Engine,
    InvalidArgument,
    Log,
    MobileRobot,
    RollingResistance,
    Tangent,
    ViscousFriction,
    ensemble,
    excitation,
    identify,
    plots,
    rk4,
    simulate,
)
from pinmobile.plots.style import INK, colour, dress

np.set_printoptions(precision=3, suppress=True, linewidth=110)

# %% [markdown]
# Here a simulation is the real robot, so that the truth is known. The engineer believes in 30 kg in the
# middle and drives it with computed torque of that belief. Poses have a noise of 1 mm and 1 mrad, forces of
# 1 N and 0.15 N m.

# %%
real = MobileRobot(mass=32, yaw_inertia=1.6, com=(0.12, -0.04))
friction = [ViscousFriction((6, 14, 1.2)), RollingResistance((4, 7, 0.6))]
true = {
    **{"mass": 32.0, "com_x": 0.12, "com_y": -0.04, "yaw_inertia": 1.6},
    **{"viscous_forward": 6.0, "viscous_left": 14.0, "viscous_yaw": 1.2},
    **{"rolling_forward": 4.0, "rolling_left": 7.0, "rolling_yaw": 0.6},
}
believed = MobileRobot(mass=30, yaw_inertia=1.5)
dt = 0.01


def driven(trajectory):
    """Return the run of the real robot, driven by what is believed of it."""
    law = ComputedTorque(believed, kp=16, kd=8)
    return simulate(
        real, law, trajectory, dt=dt, integrator=rk4, substeps=4, forces=friction, engine=Engine.COMPILED
    )


def logged(run, seed=0, delay=0):
    """Return what sensors would have logged of it."""
    return Log.from_rollout(run, noise=1e-3, input_noise=(1, 1, 0.15), delay=delay, seed=seed)


# %% [markdown]
# ## What a circle cannot tell
#
# The lecture's circle at constant speed, first. There $u$, $w$ and $r$ are constant, so every row of the
# log is the same row again: three equations, however long the robot drives, for ten unknowns. (The first
# ten seconds, in which it gets there, are left out.)

# %%
circle = Tangent(Circle(1.5, 0.6, 44.0))
round_and_round = driven(circle)
on_circle = logged(round_and_round).between(10, 44)
try:
    identify(on_circle)
except InvalidArgument as error:
    refused = str(error)
print(refused)

# %% [markdown]
# It is refused, in words. Least squares would not refuse: noise makes ten columns of rank three look like
# rank ten, and the ten numbers that come out are noise. Only with a robot to fall back on is there an
# answer: what is believed, moved in the three directions that the circle tells. What it does not tell has
# no bounds:

# %%
kept = identify(on_circle, believed)
print(f"rank {kept.rank} of {len(kept.phi)}; the mass: {kept.interval()['mass']} kg")

# %% [markdown]
# `excitation` makes a motion that tells all ten: a Fourier series (Swevers et al., 1997) whose coefficients
# make the determinant of the information largest, within limits of position, speed and acceleration. It
# begins and ends at rest.

# %%
motion = excitation(believed, duration=33.0, period=11.0, velocity=(1.2, 1.2, 1.2))
run = driven(motion)
figure, axes = plt.subplots(1, 2, figsize=(8, 3.6), layout="constrained")
for k, (name, each) in enumerate({"circle": round_and_round, "excitation": run}.items()):
    shown = each.t <= 11.0
    axes[0].plot(*each.q[shown, :2].T, color=colour(k), label=name)
    axes[1].plot(each.t[shown], each.u[shown, 0], color=colour(k), linewidth=1)
axes[0].set(xlabel="x [m]", ylabel="y [m]", aspect="equal", title="Two paths")
axes[1].set(xlabel="t [s]", ylabel="$F_x$ [N]", title="What pushes")
axes[0].legend(frameon=False, loc=(0.22, 0.55))
for each in axes:
    dress(each)

# %%
found = identify(logged(run))
print(found)

# %% [markdown]
# `identify` starts from the *weak form*, the equations integrated against a bump of 0.6 s, which needs no
# acceleration; then it fits simulations of 1.5 to 2 s to the log. It also finds a constant offset of each
# input, here none. What these leave is not white, as forces are noisy: it says so, and that intervals hold
# if noise is all it is. They cover no force that the model lacks. How well does the robot that was found
# foretell another log?

# %%
foretold = found.predict(logged(run, seed=99))
print(foretold)
plots.prediction(foretold, width=8.0)

# %% [markdown]
# ## Why the delay matters
#
# A motion capture, a filter, a network: poses come later than forces by some samples. And a force that a
# computer holds from one sample to the next is, at the sample, half of the old and half of the new: forget
# that, and poses are half a sample off even where none is late. `identify` looks for the delay and allows
# for the holding. Here poses come three samples late; the same log with delays that are taken for granted:

# %%
late = logged(run, delay=3)
right = identify(late)
print(f"delay found: {right.delay / dt:.2f} +- {right.delay_error / dt:.2f} samples")

assumed = np.array([0, 1.5, 3, 4.5])
names = "mass", "com_x", "viscous_forward", "rolling_left"
tried = [identify(late, method="weak", delay=each * dt).parameters for each in assumed]
off = {name: np.array([100 * (one[name] / true[name] - 1) for one in tried]) for name in names}

figure, axes = plt.subplots(figsize=(7, 3.8), layout="constrained")
for k, name in enumerate(names):
    axes.plot(assumed, off[name], "o-", color=colour(k), label=name.replace("_", " "))
axes.axvline(right.delay / dt, color=INK, linewidth=1, linestyle="--", label="delay found")
axes.axhline(0, color=INK, linewidth=0.8)
axes.set(xlabel="delay that is assumed [samples of 10 ms]", ylabel="error [%]")
axes.legend(frameon=False)
dress(axes)

# %%
print("error [%] where delays are   " + "  ".join(f"{each:>6g}" for each in assumed))
for name in names:
    print(f"{name:28} " + "  ".join(f"{each:6.1f}" for each in off[name]))

# %% [markdown]
# The mass hardly minds: it is told by how large forces and accelerations are. Friction does: a delay turns
# a part of what is in phase with the acceleration into something in phase with the velocity, and there
# viscous friction is. Nothing warns of it but what is left over, which grows.
#
# ## Intervals that hold
#
# An interval of 95 % is a promise: of a hundred logs, 95 hold the true value. Least squares prints intervals
# too: central differences, one `lstsq`, the covariance of white residuals. It comes in a harsh form, of poses
# as they were logged at 100 Hz, and in a milder one, which takes more care: poses are filtered first
# (Butterworth, fourth order, 4 Hz, forwards and backwards), the same filter goes over each column of the
# regressor and over the forces, and these are the mean of before and after each sample. All get the same
# three logs, each with noise of its own:


# %%
low_pass = partial(sosfiltfilt, butter(4, 4.0, fs=1 / dt, output="sos"), axis=0)


def least_squares(log, smooth=None):
    """Return estimates and 95 % intervals; `smooth` filters poses, the regressor and forces alike."""
    q = log.q if smooth is None else smooth(log.q)
    tau = log.u[1:-1] if smooth is None else (log.u[:-2] + log.u[1:-1]) / 2
    v = (q[2:] - q[:-2]) / (2 * dt)
    a = (q[2:] - 2 * q[1:-1] + q[:-2]) / dt**2
    c, s, zero = np.cos(q[1:-1, 2]), np.sin(q[1:-1, 2]), np.zeros(len(v))
    (u, w), (au, aw), (Fu, Fw) = (
        (c * each[:, 0] + s * each[:, 1], c * each[:, 1] - s * each[:, 0]) for each in (v, a, tau)
    )
    r, turn = v[:, 2], a[:, 2]
    twist = np.stack([u, w, r], axis=-1)[:, None]
    inertial = [au, -(r**2), -turn, zero], [aw, turn, -(r**2), zero], [zero, aw, -au, turn]
    inertial = np.stack([np.stack(row, axis=-1) for row in inertial], axis=1)
    rubs = np.concatenate([np.eye(3) * twist, np.eye(3) * np.sign(twist)], axis=-1)
    Y, y = np.concatenate([inertial, rubs], axis=-1), np.stack([Fu, Fw, tau[:, 2]], axis=-1)
    if smooth is not None:  # and as many rows as the filter lets be independent
        Y, y = (smooth(each)[:: round(1 / (4 * 4.0 * dt))] for each in (Y, y))
    Y, y = Y.reshape(-1, 10), y.ravel()
    phi = np.linalg.lstsq(Y, y, rcond=None)[0]
    rest = y - Y @ phi
    half = 1.96 * np.sqrt(np.diag(np.linalg.inv(Y.T @ Y)) * rest.var())
    return phi, np.column_stack([phi - half, phi + half])


answers = {"identify": [], "filtered least squares": [], "raw least squares": []}
shared = np.array([0, 4, 5, 6, 7, 8, 9])  # what both call by one name: mass and friction
truth = np.array(list(true.values()))
for seed in range(3):
    log = logged(run, seed=seed)
    intervals = identify(log).interval()
    answers["identify"].append(np.array([intervals[name] for name in true]))
    answers["filtered least squares"].append(least_squares(log, low_pass)[1])
    answers["raw least squares"].append(least_squares(log)[1])

figure, panels = plt.subplots(1, 3, figsize=(9, 3.4), sharey=True, layout="constrained")
held = {}
for axes, (name, intervals) in zip(panels, answers.items(), strict=True):
    bounds = np.array(intervals)
    inside = (bounds[..., 0] <= truth) & (truth <= bounds[..., 1])
    held[name] = inside[:, shared].mean()
    for row, k in enumerate(shared):
        for seed, (low, high) in enumerate(100 * (bounds[:, k] / truth[k] - 1)):
            y = row + 0.2 * (seed - 1)
            own = colour(0 if inside[seed, k] else 1)
            axes.plot([low, high], [y, y], ".-", color=own, linewidth=1.8, markersize=3)
    axes.axvline(0, color=INK, linewidth=1, linestyle="--")
    axes.set(xlabel="off by [%]", title=name)
    dress(axes)
labels = [list(true)[k].replace("_", " ") for k in shared]
_ = panels[0].set(yticks=range(len(shared)), yticklabels=labels, ylim=(len(shared) - 0.4, -0.6))

# %%
for name, share in held.items():
    print(f"{name:22} {100 * share:3.0f} of 100 intervals of mass and friction hold the true value")

# %% [markdown]
# (Dashed: the truth; three logs in each row. Intervals that miss it are in the second colour: of `identify`
# none of the 21.)
# Raw least squares is sure of itself and wrong: second differences of noisy poses are mostly noise, and noise
# in a *column* makes its coefficient too small, which no amount of data mends. The filter mends most of that:
# its estimates are near. What it leaves of the noise hangs together from row to row, though, and dry friction
# changes its sign faster than 4 Hz, so the formula for white residuals still promises too much. `identify`
# takes its intervals from how much these segments disagree (a jackknife, CR3), whatever colour the
# noise has.
#
# ## The decision
#
# What a log leaves open goes on, jointly, to an ensemble. How near does the robot stay to the circle, with
# a controller that has the model found?

# %%
spread = found.spread(1000)
tuned = ComputedTorque(found.robot(), kp=16, kd=8)
fleet = ensemble(
    found.robot(), tuned, Tangent(Circle(1, 0.5, 10)), n=1000, spread=spread, forces=found.forces(), dt=0.02
)
within = fleet.error_quantile(0.99).distance
print(f"99 % of the robots that the log allows stay within {1e3 * within:.1f} mm")

# %% [markdown]
# ## What was shown
#
# A circle at constant speed tells three of ten numbers, and `identify` says which it does not. A delay of
# three samples that nobody mentioned spoils friction and leaves the mass alone. And intervals hold where
# their reason is how logs disagree, not a formula for white noise.

# %%
assert "rank 3 of 10" in refused, "the circle is not refused"
assert kept.rank == 3, "the circle tells something else"
assert kept.interval()["mass"] == (0, np.inf), "the circle bounds the mass"
assert found.rank == len(found.phi), "the excitation does not tell all"
assert abs(right.delay / dt - 3) < 0.5, "the delay is not found"
assert abs(off["mass"][0]) < 2, "the mass minds the delay"
assert abs(off["viscous_forward"][0]) > 20, "friction does not mind the delay"
assert np.abs(off["viscous_forward"][2]) < 8, "friction is off though the delay is right"
assert held["identify"] > 0.85, "intervals do not hold"
assert held["raw least squares"] < 0.6, "intervals of raw least squares hold"
assert held["filtered least squares"] < 0.85, "intervals of filtered least squares hold"
assert within < 0.05, "the robots stray"
of_100 = {name: f"{100 * share:.0f}" for name, share in held.items()}
print(
    f"Shown: a circle tells {kept.rank} of 10; three samples ignored put viscous friction "
    f"{abs(off['viscous_forward'][0]):.0f} % off, the mass {abs(off['mass'][0]):.1f} %; of 100 intervals "
    f"{of_100['identify']} hold, of least squares {of_100['filtered least squares']} where poses are "
    f"filtered and {of_100['raw least squares']} where they are not."
)
