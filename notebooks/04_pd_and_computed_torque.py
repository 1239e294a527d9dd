# %% [markdown]
# # 4 PD and computed torque, right model and wrong model
#
# This notebook compares two controllers of the lecture. The error $e = q_d - q$ has the units m, m, rad:
#
# $$\text{PD:}\quad \tau = K_p e + K_d \dot e
# \qquad
# \text{computed torque:}\quad \tau = M(q)\,(\ddot q_d + K_d \dot e + K_p e) + n(q, \dot q)$$
#
# PD uses no model of the robot. Computed torque contains a controller model, and its accuracy depends on
# that model. The notebook has four parts. It reproduces the lecture's numbers, moves the centre of mass,
# gives computed torque a wrong model, and shows how to write a new controller.

# %%
from dataclasses import dataclass

import matplotlib.pyplot as plt
import numpy as np

from pinmobile import (
    PD,
    Circle,
    ComputedTorque,
    ConstantForce,
    CubicVia,
    Diverged,
    InputSaturation,
    MobileRobot,
    Tangent,
    Uniform,
    ensemble,
    plots,
    simulate,
)
from pinmobile.controllers import plain_difference
from pinmobile.plots.style import colour, dress
from pinmobile.trajectories import LectureHeading

# %% [markdown]
# ## The lecture's six runs
#
# The robot has a mass of 30 kg and $I_{cz} = 0.1$ kg m². Its centre of mass is at the origin of the body
# frame. Each run takes 60 s with a sampling time of 0.1 s. The controller computes a force at each
# sample, and the force stays constant until the next sample (zero-order hold). Computed torque has the
# gains $K_p = K_d = 4$ (in 1/s² and 1/s). PD has the gains 120, 120 and 0.4. To reproduce the lecture's
# numbers, these runs use its heading and its plain subtraction (see
# [notebook 3](03_trajectories_and_heading.ipynb)).

# %%
robot = MobileRobot.lecture()
points = {"start": (0, 0), "via": (2, 2), "end": (0, 4)}
paths = {
    "via stop": CubicVia(**points, t_via=30, t_end=60, via_velocity=(0, 0)),
    "via free": CubicVia(**points, t_via=30, t_end=60),
    "circle": Circle(radius=3, rate=0.1, duration=60),
}
controllers = {
    "PD": PD((120, 120, 0.4), (120, 120, 0.4), difference=plain_difference),
    "computed torque": ComputedTorque(robot, 4, 4, difference=plain_difference),
}

found = {}
for path_name, path in paths.items():
    for controller_name, controller in controllers.items():
        rollout = simulate(robot, controller, LectureHeading(path), dt=0.1)
        x, y, psi = rollout.max_error()
        found[path_name, controller_name] = (f"{x:.6e}", f"{y:.6e}")

# %% [markdown]
# Another interpreter of MATLAB's language executed the lecture's script. It gave these largest errors in m:

# %%
lecture = {
    ("via stop", "PD"): ("3.219048e-03", "3.121481e-03"),
    ("via stop", "computed torque"): ("1.037037e-05", "1.037037e-05"),
    ("via free", "PD"): ("3.219048e-03", "1.613704e-03"),
    ("via free", "computed torque"): ("1.037037e-05", "2.592593e-06"),
    ("circle", "PD"): ("7.481303e-03", "7.481287e-03"),
    ("circle", "computed torque"): ("3.491279e-05", "3.491278e-05"),
}
heads = "x, pinmobile  x, lecture    y, pinmobile  y, lecture"
print(f"{'largest error [m]':26}  {heads}")
for (path_name, controller_name), (x, y) in lecture.items():
    x_found, y_found = found[path_name, controller_name]
    row = f"{x_found:12}  {x:12}  {y_found:12}  {y}"
    print(f"{path_name:9} {controller_name:16}  {row}")

# %% [markdown]
# ## The causes of the errors
#
# From here on, the reference is the circle with the correct heading. The figures compare the two
# controllers:

# %%
circle = Tangent(Circle(radius=3, rate=0.1, duration=60))
pd = PD((120, 120, 0.4), (120, 120, 0.4))
runs = {
    "PD": simulate(robot, pd, circle, dt=0.1),
    "computed torque": simulate(robot, ComputedTorque(robot), circle, dt=0.1),
}
plots.path(runs, title="The circle: desired and simulated path")

# %%
plots.errors(runs)

# %% [markdown]
# **PD** needs an error to produce a force. The circle requires the acceleration
# $r\omega^2 = 3 \cdot 0.1^2 = 0.03$ m/s². PD produces the acceleration $\tau/m = 4e + 4\dot e$, and
# $\dot e$ is small. So
#
# $$e \approx \frac{r\omega^2}{4} = 0.0075\ \mathrm{m} .$$
#
# **Computed torque** obtains this acceleration from its model. Its error comes from the zero-order hold:
# during $\Delta t$ the desired acceleration changes by $r\omega^3 \Delta t$. The mean change is half of
# that. So
#
# $$e \approx \frac{r\omega^3 \Delta t}{2 \cdot 4} = 0.0000375\ \mathrm{m} .$$

# %%
estimates = {"PD": 3 * 0.1**2 / 4, "computed torque": 3 * 0.1**3 * 0.1 / 8}  # [m]
for name, estimate in estimates.items():
    simulated = runs[name].max_error()[0]
    print(f"{name:16} estimated {estimate:.2e} m, simulated {simulated:.2e} m")

# %% [markdown]
# ## The sampling time
#
# These formulas imply that the error of computed torque is proportional to $\Delta t$, and that the
# error of PD does not depend on $\Delta t$. The figure confirms both.

# %%
sampling_times = [0.2, 0.1, 0.05, 0.02, 0.01]  # [s]
computed_torque = ComputedTorque(robot)
error_pd, error_ct = [], []
for dt in sampling_times:
    error_pd.append(simulate(robot, pd, circle, dt=dt).max_error()[0])
    error_ct.append(simulate(robot, computed_torque, circle, dt=dt).max_error()[0])

figure, axes = plt.subplots(figsize=(7, 3.4), layout="constrained")
axes.loglog(sampling_times, error_pd, "o-", color=colour(0), label="PD")
axes.loglog(sampling_times, error_ct, "o-", color=colour(1), label="computed torque")
axes.set(xlabel=r"sampling time $\Delta t$ [s]", ylabel="largest error in x [m]")
axes.set_title("Error on the circle")
axes.legend()
dress(axes)

# %% [markdown]
# ## An offset centre of mass
#
# The lecture's PD gains are $4M$ for $x_{bc} = y_{bc} = 0$: 4 · 30 kg and 4 · 0.1 kg m². In this section
# the centre of mass is at (0.1, 0.05) m. The model of computed torque contains this offset, so its
# position errors are unchanged. PD diverges:

# %%
offset = MobileRobot(mass=30, yaw_inertia=0.1, com=(0.1, 0.05))
with_offset = simulate(offset, ComputedTorque(offset), circle, dt=0.1)
print("computed torque:", with_offset)
print()
try:
    simulate(offset, pd, circle, dt=0.1)
    pd_diverged_at = None
except Diverged as error:
    pd_diverged_at = error.time
    until_divergence = error.rollout
    print("PD:", error)

# %% [markdown]
# The lecture's script would continue and print numbers beyond the largest floating-point number. The
# library stops the loop and keeps the samples recorded until then. The forces change sign between
# samples, and their amplitude grows:

# %%
plots.forces(until_divergence, title="PD with an offset centre of mass, until it diverges")

# %% [markdown]
# ### The reason
#
# With the offset, the error obeys $\ddot e \approx -M^{-1}(K_d \dot e + K_p e)$. The matrix $M^{-1} K_d$
# has an eigenvalue $k$ (in 1/s) far above 4. In the direction of its eigenvector, a rotation about the
# centre of mass, the robot has a very small inertia. A constant force during $\Delta t$ overshoots in
# this direction. It amplifies the error when $k\,\Delta t > 2$.

# %%
M = offset.mass_matrix([0, 0, 0])
rates = np.linalg.eigvals(np.linalg.solve(M, np.diag([120, 120, 0.4])))
k_largest = rates.real.max()
limit = 2 / k_largest  # [s]
print(f"k = {k_largest:.2f} 1/s, so the sampling time must be below {limit:.4f} s")
for dt in [0.1, 0.08]:
    try:
        print(f"dt = {dt} s: {simulate(offset, pd, circle, dt=dt)!r}")
    except Diverged as error:
        print(f"dt = {dt} s: {error}")

# %% [markdown]
# ### A realistic robot
#
# $I_{cz} = 0.1$ kg m² is far too small for a box of 30 kg with a length of 0.6 m and a width of 0.4 m. A
# homogeneous box has $m (l^2 + w^2)/12 = 1.3$ kg m². With this inertia, $k$ is small, and PD with a
# sampling time of 0.1 s is stable. PD now has an error in the heading, too: on the circle, the inertial
# force at the offset centre of mass produces a moment, and PD has no feedforward for it.

# %%
box = MobileRobot(mass=30, yaw_inertia=1.3, com=(0.1, 0.05))
pd_box = PD((120, 120, 5.2), (120, 120, 5.2))  # 4 times 30 kg and 1.3 kg m²
runs = {
    "PD": simulate(box, pd_box, circle, dt=0.1),
    "computed torque": simulate(box, ComputedTorque(box), circle, dt=0.1),
}
for name, run in runs.items():
    x, y, psi = 1e3 * run.max_error()
    print(f"{name:16} x {x:.3f} mm, y {y:.3f} mm, psi {psi:.3f} mrad")

# %% [markdown]
# ## The wrong model
#
# The controller model can differ from the simulated robot. The first difference is the mass. The robot
# has 30 kg (and 1.3 kg m²), and the controller model has another mass $\hat m$. The relative error of
# the modelled acceleration is $m/\hat m - 1$. The position error is
#
# $$e \approx \left|\frac{m}{\hat m} - 1\right| \frac{r\omega^2}{4} .$$

# %%
model_masses = np.array([15, 20, 25, 28, 30, 32, 35, 40, 50, 60])  # [kg]
error_wrong_mass = []
for mass in model_masses:
    model = MobileRobot(mass=mass, yaw_inertia=1.3 * mass / 30, com=(0.1, 0.05))
    run = simulate(box, ComputedTorque(model), circle, dt=0.1)
    error_wrong_mass.append(run.max_error()[0])
error_wrong_mass = np.array(error_wrong_mass)
estimate = np.abs(30 / model_masses - 1) * 0.03 / 4
look = {"color": colour(1), "label": "computed torque"}

figure, axes = plt.subplots(figsize=(7, 3.4), layout="constrained")
axes.plot(model_masses, 1e3 * estimate, "--", color=colour(2), label="estimate")
axes.plot(model_masses, 1e3 * error_wrong_mass, "o", **look)
axes.axhline(1e3 * runs["PD"].max_error()[0], color=colour(0), label="PD")
axes.set(xlabel="mass of the controller model [kg]", ylabel="largest error in x [mm]")
axes.set_title("Error with a wrong mass in the model (robot: 30 kg)")
axes.legend()
dress(axes)

# %% [markdown]
# With half the mass in its model, computed torque is no better than PD. A model that is too light gives a
# larger error than a model that is too heavy by the same factor. But the heavy model also has higher
# gains, and the sampling time limits the gains.
#
# The second difference is the centre of mass. The controller model has it at the origin.

# %%
centred_box = MobileRobot(mass=30, yaw_inertia=1.3)
runs = {
    "PD": simulate(box, pd_box, circle, dt=0.1),
    "wrong centre of mass": simulate(box, ComputedTorque(centred_box), circle, dt=0.1),
    "right model": simulate(box, ComputedTorque(box), circle, dt=0.1),
}
plots.errors(runs)

# %% [markdown]
# The largest effect is on the heading. The circle requires the moment $m\,x_{bc}\,r\omega^2 = 0.09$ N m,
# and the controller model does not contain it. Only an error in the heading produces this moment:
# $0.09 / (4 \cdot 1.3) = 0.0173$ rad.
#
# With the lecture's small $I_{cz}$, the same mistake makes computed torque diverge, for the same reason
# as PD. The matrix $\hat M K_d$ equals PD's gain matrix, so $M^{-1} \hat M K_d$ has the same large
# eigenvalue.

# %%
try:
    simulate(offset, ComputedTorque(robot), circle, dt=0.1)
    wrong_com_diverged = False
except Diverged as error:
    wrong_com_diverged = True
    print(error)

# %% [markdown]
# ## Your own controller
#
# Neither controller compensates a steady wind. PD needs the error $F / k_p$ to balance the wind force
# $F$. An integral of the error converges to that force. But when the input is limited, the integral
# continues to grow although the robot cannot apply the result. Then the robot overshoots. This effect
# is *windup*. [Back-calculation](https://en.wikipedia.org/wiki/Integral_windup) prevents it: it
# subtracts from the integral the part of the input that the limits removed.
#
# A controller is a frozen dataclass. Each call receives the controller's memory and returns the next
# memory. The method `applied` receives the applied input, after all limits. The same class runs in
# `simulate` and, compiled, in `ensemble`. A spread can vary its fields, for example `ki`:


# %%
@dataclass(frozen=True)
class PID:
    kp: float = 120.0
    ki: float = 60.0
    kd: float = 120.0
    back: float = 2.0  # gain of back-calculation [1/s]; 0: windup

    def initial_state(self, context):
        loop = context.dt, context.difference
        return {"sum": np.zeros(3), "computed": np.zeros(3), "loop": loop}

    def __call__(self, t, q, v, reference, state):
        dt, difference = state["loop"]
        error = difference(q, reference.q)
        u = self.kp * error + self.kd * (reference.v - v) + state["sum"]
        return u, state | {"sum": state["sum"] + dt * self.ki * error, "computed": u}

    def applied(self, u, state):
        change = state["loop"][0] * self.back * (u - state["computed"])
        return state | {"sum": state["sum"] + change}


# %% [markdown]
# In the first test, one robot starts 1.5 m from the circle in a wind of 15 N. Each force of the
# controller is at most 20 N:

# %%
tested = {"PD": PD(120, 120), "PID with windup": PID(back=0.0), "PID": PID()}
limited = {name: InputSaturation(one, (20, 20, 5)) for name, one in tested.items()}
start = {"q0": circle(0).q + np.array([0, -1.5, 0]), "v0": circle(0).v}
wind = [ConstantForce((15, 0, 0))]
windy = {
    name: simulate(box, one, circle, dt=0.01, forces=wind, duration=20.0, **start)
    for name, one in limited.items()
}
plots.errors(windy)

# %% [markdown]
# In the second test, each of two thousand robots has another wind and another start:

# %%
no_wind = [ConstantForce((0, 0, 0))]  # the spread replaces its x component
options = {
    "n": 2_000,
    "spread": {"force.x": Uniform(-15, 15), "start.y": Uniform(-1.5, 1.5)},
    "forces": no_wind,
    "dt": 0.01,
    "after": 8,  # [s]
}
error_99 = {}
for name, one in limited.items():
    fleet = ensemble(box, one, circle, **options)
    error_99[name] = fleet.error_quantile(0.99).distance
    print(
        f"{name:15} engine {fleet.engine}: after 8 s, 99 % of the robots stay "
        f"within {1e3 * error_99[name]:.1f} mm"
    )

# %% [markdown]
# ## The claim
#
# The library reproduces the lecture's twelve numbers in every digit. Computed torque with the right
# model has the same position errors for every centre of mass. PD diverges where the eigenvalue predicts
# it. The formulas predict the errors of a wrong model. An integral without windup compensates the wind.

# %%
for key, expected in lecture.items():
    assert found[key] == expected, f"a number differs from the lecture: {key}"
x, y, psi = with_offset.max_error()
assert np.allclose([x, y], [3.491279e-05, 3.491278e-05]), "the offset changes the error"
assert psi < 1e-12, "computed torque has an error in the heading"
ratio_ct, ratio_pd = error_ct[1] / error_ct[4], error_pd[1] / error_pd[4]
assert abs(ratio_ct - 10) < 1, "the error of computed torque is not proportional to dt"
assert abs(ratio_pd - 1) < 0.1, "the error of PD depends on dt"
assert pd_diverged_at is not None, "PD does not diverge"
assert 0.08 < limit < 0.1, "the eigenvalue does not predict the limit of dt"
assert wrong_com_diverged, "computed torque with a wrong centre of mass is stable"
assert np.abs(error_wrong_mass - estimate).max() < 3e-4, "the mass estimate is wrong"
x, _, psi = runs["wrong centre of mass"].max_error()
x_right = runs["right model"].max_error()[0]
assert x > 5 * x_right, "the wrong centre of mass has no effect"
assert abs(psi / 0.0173 - 1) < 0.05, "the heading error differs from the estimate"
# PD balances a wind of up to 15 N and the inertial force on the circle.
assert 0.12 < error_99["PD"] < 0.135, "PD has another error in the wind"
assert error_99["PID with windup"] > 20 * error_99["PID"], "the integral has no windup"
assert error_99["PID"] < 0.01, "the integral does not compensate the wind"
print("Shown: all twelve numbers equal the lecture's.")
print("Shown: the accuracy of computed torque depends on its model.")
