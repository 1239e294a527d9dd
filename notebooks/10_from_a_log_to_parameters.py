# %% [markdown]
# # 10 From a log to parameters
#
# Notebook 6 showed how large an error of the model may be. A log of the robot shows how
# large it is. The log contains the pose $q = (x, y, \psi)$ and the force
# $\tau = (F_x, F_y, M_z)$. In body axes, with the twist $(u, w, r)$ of the origin, the
# lecture's equations with friction are
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
# They are *linear* in ten parameters: $m$, $m x_{bc}$, $m y_{bc}$, $I$ and six
# parameters of friction. A log of one minute has thousands of such rows, so one call of
# `lstsq` seems sufficient. But three problems arise:
#
# - Some motions do not make all parameters identifiable.
# - The measured poses are late.
# - Confidence intervals are often too narrow.

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
# Here a simulation replaces the real robot, so the true parameters are known. The
# nominal model has 30 kg and its centre of mass in the middle. Computed torque with
# this model drives the robot. The noise has a standard deviation of 1 mm and 1 mrad for
# poses, and of 1 N and 0.15 N m for forces.

# %%
real = MobileRobot(mass=32, yaw_inertia=1.6, com=(0.12, -0.04))
friction = [ViscousFriction((6, 14, 1.2)), RollingResistance((4, 7, 0.6))]
true = {
    **{"mass": 32.0, "com_x": 0.12, "com_y": -0.04, "yaw_inertia": 1.6},
    **{"viscous_forward": 6.0, "viscous_left": 14.0, "viscous_yaw": 1.2},
    **{"rolling_forward": 4.0, "rolling_left": 7.0, "rolling_yaw": 0.6},
}
nominal = MobileRobot(mass=30, yaw_inertia=1.5)
dt = 0.01


def driven(trajectory):
    """Return the run of the real robot under computed torque with the nominal model."""
    law = ComputedTorque(nominal, kp=16, kd=8)
    options = {"integrator": rk4, "substeps": 4, "engine": Engine.COMPILED}
    return simulate(real, law, trajectory, dt=dt, forces=friction, **options)


def logged(run, seed=0, delay=0):
    """Return the log that sensors would record of a run."""
    return Log.from_rollout(run, noise=1e-3, input_noise=(1, 1, 0.15), delay=delay, seed=seed)


# %% [markdown]
# ## A circle is not enough
#
# The first motion is the lecture's circle at constant speed. There $u$, $w$ and $r$ are
# constant, so all rows of the log repeat the same three equations. Three equations
# cannot determine ten unknowns, however long the robot drives. The first ten seconds
# are left out, because the robot accelerates during them.

# %%
circle = Tangent(Circle(1.5, 0.6, 44.0))
round_and_round = driven(circle)
on_circle = logged(round_and_round).between(10, 44)
try:
    identify(on_circle)
except InvalidArgument as error:
    message = str(error)
print(message)

# %% [markdown]
# `identify` raises an error and names the parameters. Least squares would raise no
# error: noise gives the ten columns of rank three the rank ten, and the ten estimates
# are noise. With a prior, `identify` returns a result. Here the prior is the nominal
# model. The log changes it in the three directions that the circle determines. The
# other directions have no bounds:

# %%
kept = identify(on_circle, nominal)
low, high = kept.interval()["mass"]
print(f"rank {kept.rank} of {len(kept.phi)}; interval of the mass: {low:g} to {high:g} kg")

# %% [markdown]
# `excitation` designs a motion that makes all ten parameters identifiable. The motion
# is a Fourier series (Swevers et al., 1997). Its coefficients maximise the determinant
# of the information matrix, within limits of position, speed and acceleration. The
# motion begins and ends at rest.

# %%
motion = excitation(nominal, duration=33.0, period=11.0, velocity=(1.2, 1.2, 1.2))
run = driven(motion)
figure, axes = plt.subplots(1, 2, figsize=(8, 3.6), layout="constrained")
for k, (name, each) in enumerate({"circle": round_and_round, "excitation": run}.items()):
    shown = each.t <= 11.0
    axes[0].plot(*each.q[shown, :2].T, color=colour(k), label=name)
    axes[1].plot(each.t[shown], each.u[shown, 0], color=colour(k), linewidth=1)
axes[0].set(xlabel="x [m]", ylabel="y [m]", aspect="equal", title="Two paths")
axes[1].set(xlabel="t [s]", ylabel="$F_x$ [N]", title="Force")
axes[0].legend(frameon=False, loc=(0.22, 0.55))
for each in axes:
    dress(each)

# %%
found = identify(logged(run))
print(found)

# %% [markdown]
# `identify` starts with the *weak form*: it multiplies the equations by a smooth pulse
# of 0.6 s and integrates them. So it needs no accelerations. Then it fits simulations
# of 1.5 to 2 s to the log. It also estimates a constant offset of each input, which is
# zero here.
#
# The residual is not white, because the forces are noisy. The output states this. It
# also states that the intervals are valid if noise causes the whole residual. The
# intervals do not cover a force that the model lacks. The next cell uses the estimates
# to predict another log:

# %%
prediction = found.predict(logged(run, seed=99))
print(prediction)
plots.prediction(prediction, width=8.0)

# %% [markdown]
# ## Why the delay matters
#
# Motion capture, filters and networks delay the measured poses by some samples relative
# to the forces. The zero-order hold causes a second shift. At a sample the force
# changes from its old to its new value, so its mean value there is the average of both.
# A method that ignores this shifts the poses by half a sample, even without a delay.
# `identify` estimates the delay and models the hold. Here the poses come three samples
# late. The next cell also identifies the same log with four assumed delays:

# %%
late = logged(run, delay=3)
right = identify(late)
print(f"estimated delay: {right.delay / dt:.2f} +- {right.delay_error / dt:.2f} samples")

assumed = np.array([0, 1.5, 3, 4.5])
names = "mass", "com_x", "viscous_forward", "rolling_left"
tried = [identify(late, method="weak", delay=each * dt).parameters for each in assumed]
off = {}
for name in names:
    off[name] = np.array([100 * (one[name] / true[name] - 1) for one in tried])

figure, axes = plt.subplots(figsize=(7, 3.8), layout="constrained")
for k, name in enumerate(names):
    axes.plot(assumed, off[name], "o-", color=colour(k), label=name.replace("_", " "))
style = {"color": INK, "linewidth": 1, "linestyle": "--"}
axes.axvline(right.delay / dt, **style, label="estimated delay")
axes.axhline(0, color=INK, linewidth=0.8)
axes.set(xlabel="assumed delay [samples of 10 ms]", ylabel="error [%]")
axes.legend(frameon=False)
dress(axes)

# %%
print("error [%] for delay [samples]" + "  ".join(f"{each:>6g}" for each in assumed))
for name in names:
    print(f"{name:28} " + "  ".join(f"{each:6.1f}" for each in off[name]))

# %% [markdown]
# The delay hardly changes the estimate of the mass. The mass follows from the size of
# forces and accelerations. The delay strongly changes the estimates of friction. It
# turns a part of the force in phase with the acceleration into a force in phase with
# the velocity, like viscous friction. The only warning is the residual, which grows.
#
# ## Valid intervals
#
# A valid 95 % interval contains the true value in 95 of 100 logs. Least squares gives
# intervals too, from central differences, one `lstsq` and the covariance of white
# residuals. The next cell compares `identify` with two forms of least squares:
#
# - The raw form uses the poses as logged at 100 Hz.
# - The filtered form first filters the poses (Butterworth, fourth order, 4 Hz, forwards
#   and backwards). It applies the same filter to each column of the regressor and to
#   the forces. Its force at a sample is the mean of the values before and after it.
#
# All three methods receive the same three logs, which differ in their noise:


# %%
low_pass = partial(sosfiltfilt, butter(4, 4.0, fs=1 / dt, output="sos"), axis=0)


def least_squares(log, smooth=None):
    """Return estimates and 95 % intervals; `smooth` filters poses, regressor and forces."""
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
    rows = [au, -(r**2), -turn, zero], [aw, turn, -(r**2), zero], [zero, aw, -au, turn]
    inertial = np.stack([np.stack(row, axis=-1) for row in rows], axis=1)
    rubs = np.concatenate([np.eye(3) * twist, np.eye(3) * np.sign(twist)], axis=-1)
    Y = np.concatenate([inertial, rubs], axis=-1)
    y = np.stack([Fu, Fw, tau[:, 2]], axis=-1)
    if smooth is not None:  # keep as many rows as are independent after the filter
        Y, y = (smooth(each)[:: round(1 / (4 * 4.0 * dt))] for each in (Y, y))
    Y, y = Y.reshape(-1, 10), y.ravel()
    phi = np.linalg.lstsq(Y, y, rcond=None)[0]
    rest = y - Y @ phi
    half = 1.96 * np.sqrt(np.diag(np.linalg.inv(Y.T @ Y)) * rest.var())
    return phi, np.column_stack([phi - half, phi + half])


answers = {"identify": [], "filtered least squares": [], "raw least squares": []}
shared = np.array([0, 4, 5, 6, 7, 8, 9])  # parameters of both: mass and friction
truth = np.array(list(true.values()))
for seed in range(3):
    log = logged(run, seed=seed)
    intervals = (identify(log) if seed else found).interval()  # the first log is that of above
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
    axes.set(xlabel="error [%]", title=name)
    dress(axes)
labels = [list(true)[k].replace("_", " ") for k in shared]
_ = panels[0].set(yticks=range(len(shared)), yticklabels=labels, ylim=(len(shared) - 0.4, -0.6))

# %%
print("intervals of mass and friction that contain the true value")
for name, share in held.items():
    print(f"{name:22} {100 * share:3.0f} of 100")

# %% [markdown]
# The dashed lines mark the true values, and each row shows three logs. Intervals that
# miss the true value have the second colour. `identify` has none of them among its 21
# intervals.
#
# Raw least squares gives wrong estimates with intervals that are too narrow. Its
# estimate of the mass is almost zero. Second differences of noisy poses are mostly
# noise. Noise in a *column* of the regressor makes its coefficient too small, and more
# data does not correct this. The filter corrects most of it, and the estimates are
# close to the true values. But the remaining noise is correlated from row to row, and
# dry friction changes its sign faster than 4 Hz. So the formula for white residuals
# still gives intervals that are too narrow. `identify` computes its intervals from the
# differences between segments of the log (a jackknife, CR3). These differences contain
# the effect of correlated noise too.
#
# ## Use in an ensemble
#
# The log leaves an uncertainty of all parameters, with their correlations.
# `found.spread` passes it to an ensemble. The controller uses the identified model. The
# next cell computes how close the robots stay to the circle:

# %%
spread = found.spread(1000)
tuned = ComputedTorque(found.robot(), kp=16, kd=8)
options = {"n": 1000, "spread": spread, "forces": found.forces(), "dt": 0.02}
fleet = ensemble(found.robot(), tuned, Tangent(Circle(1, 0.5, 10)), **options)
within = fleet.error_quantile(0.99).distance
print(f"99 % of the robots stay within {1e3 * within:.1f} mm of the circle")

# %% [markdown]
# ## The claim
#
# - A circle at constant speed determines three combinations of ten parameters.
#   `identify` names the parameters that it leaves open.
# - An ignored delay of three samples makes the estimates of friction wrong. The
#   estimate of the mass stays right.
# - Intervals from the differences between segments contain the true values. Intervals
#   from the formula for white noise are too narrow.

# %%
assert "rank 3 of 10" in message, "no error for the circle"
assert kept.rank == 3, "the circle has another rank"
assert kept.interval()["mass"] == (0, np.inf), "the circle bounds the mass"
assert found.rank == len(found.phi), "a parameter is not identifiable"
assert abs(right.delay / dt - 3) < 0.5, "the estimated delay is wrong"
assert abs(off["mass"][0]) < 2, "the delay changes the mass"
assert abs(off["viscous_forward"][0]) > 20, "the delay does not change friction"
assert np.abs(off["viscous_forward"][2]) < 8, "friction is wrong with the right delay"
assert held["identify"] > 0.95, "an interval of identify misses the true value"
assert held["raw least squares"] < 0.6, "raw least squares has valid intervals"
assert held["filtered least squares"] < 0.85, "filtered least squares has valid intervals"
assert within < 0.05, "the robots leave the circle"
of_100 = {name: f"{100 * share:.0f}" for name, share in held.items()}
print(
    f"Shown: a circle has rank {kept.rank} of 10. An ignored delay of three samples changes "
    f"viscous friction by {abs(off['viscous_forward'][0]):.0f} % and the mass by "
    f"{abs(off['mass'][0]):.1f} %. Of 100 intervals, {of_100['identify']} of identify contain "
    f"the true value, {of_100['filtered least squares']} of filtered least squares and "
    f"{of_100['raw least squares']} of raw least squares."
)
