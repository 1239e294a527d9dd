# %% [markdown]
# # 4 PD and computed torque, right model and wrong model
#
# Two controllers of the lecture, with the error $e = q_d - q$ in m, m, rad:
#
# $$\text{PD:}\quad \tau = K_p e + K_d \dot e
# \qquad
# \text{computed torque:}\quad \tau = M(q)\,(\ddot q_d + K_d \dot e + K_p e) + n(q, \dot q)$$
#
# PD knows nothing of the robot. Computed torque contains a model of it, and is as good as that model.
# This notebook first reproduces the lecture's numbers, then moves the centre of mass, then lies to the
# controller, and last it writes a controller of its own.

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
# The robot has 30 kg, $I_{cz} = 0.1$ kg m² and its centre of mass at the origin of the body frame. The
# loop is sampled every 0.1 s for 60 s: the controller computes a force, which is held until the next
# sample. Computed torque has $K_p = K_d = 4$ (in 1/s² and 1/s), PD has 120, 120 and 0.4. To have the
# lecture's numbers, its heading and its plain subtraction are taken, too (see
# [notebook 3](03_trajectories_and_heading.ipynb)).

# %%
robot = MobileRobot.lecture()
paths = {
    "via stop": CubicVia((0, 0), (2, 2), (0, 4), t_via=30, t_end=60, via_velocity=(0, 0)),
    "via free": CubicVia((0, 0), (2, 2), (0, 4), t_via=30, t_end=60),
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
# The lecture's script, run in another interpreter of MATLAB's language, gave these largest errors, in m:

# %%
lecture = {
    ("via stop", "PD"): ("3.219048e-03", "3.121481e-03"),
    ("via stop", "computed torque"): ("1.037037e-05", "1.037037e-05"),
    ("via free", "PD"): ("3.219048e-03", "1.613704e-03"),
    ("via free", "computed torque"): ("1.037037e-05", "2.592593e-06"),
    ("circle", "PD"): ("7.481303e-03", "7.481287e-03"),
    ("circle", "computed torque"): ("3.491279e-05", "3.491278e-05"),
}
print("largest error [m]           x, here       x, lecture    y, here       y, lecture")
for (path_name, controller_name), (x, y) in lecture.items():
    x_here, y_here = found[path_name, controller_name]
    print(f"{path_name:9} {controller_name:16}  {x_here}  {x}  {y_here}  {y}")

# %% [markdown]
# ## Where the numbers come from
#
# On the circle, with the heading put right from here on. The two runs side by side:

# %%
circle = Tangent(Circle(radius=3, rate=0.1, duration=60))
pd = PD((120, 120, 0.4), (120, 120, 0.4))
runs = {
    "PD": simulate(robot, pd, circle, dt=0.1),
    "computed torque": simulate(robot, ComputedTorque(robot), circle, dt=0.1),
}
plots.path(runs, title="The circle: desired and travelled path")

# %%
plots.errors(runs)

# %% [markdown]
# **PD** must have an error to make a force. The circle needs the acceleration
# $r\omega^2 = 3 \cdot 0.1^2 = 0.03$ m/s², and $\tau/m$ supplies $4e$ (and $4\dot e$, which is small).
# So
#
# $$e \approx \frac{r\omega^2}{4} = 0.0075\ \mathrm{m} .$$
#
# **Computed torque** supplies the acceleration by its model. What is left comes from holding the force
# for $\Delta t$: meanwhile the desired acceleration moves on by $r\omega^3 \Delta t$, half of it on
# average. So
#
# $$e \approx \frac{r\omega^3 \Delta t}{2 \cdot 4} = 0.0000375\ \mathrm{m} .$$

# %%
for name, estimate in [("PD", 3 * 0.1**2 / 4), ("computed torque", 3 * 0.1**3 * 0.1 / 8)]:
    print(f"{name:16} estimated {estimate:.2e} m, found {runs[name].max_error()[0]:.2e} m")

# %% [markdown]
# ## The sampling time
#
# If that is so, the error of computed torque is proportional to $\Delta t$, and that of PD does not
# depend on it.

# %%
sampling_times = [0.2, 0.1, 0.05, 0.02, 0.01]  # [s]
error_pd, error_ct = [], []
for dt in sampling_times:
    error_pd.append(simulate(robot, pd, circle, dt=dt).max_error()[0])
    error_ct.append(simulate(robot, ComputedTorque(robot), circle, dt=dt).max_error()[0])

figure, axes = plt.subplots(figsize=(7, 3.4), layout="constrained")
axes.loglog(sampling_times, error_pd, "o-", color=colour(0), label="PD")
axes.loglog(sampling_times, error_ct, "o-", color=colour(1), label="computed torque")
axes.set(xlabel=r"sampling time $\Delta t$ [s]", ylabel="largest error in x [m]", title="Circle")
axes.legend()
dress(axes)

# %% [markdown]
# ## The centre of mass moves
#
# The lecture's PD gains are $4M$ for $x_{bc} = y_{bc} = 0$: 4 · 30 kg and 4 · 0.1 kg m². Now the centre
# of mass lies at (0.1, 0.05) m. Computed torque is told, and does not mind. PD does:

# %%
offset = MobileRobot(mass=30, yaw_inertia=0.1, com=(0.1, 0.05))
told = simulate(offset, ComputedTorque(offset), circle, dt=0.1)
print("computed torque:", told)
print()
try:
    simulate(offset, pd, circle, dt=0.1)
    pd_diverged_at = None
except Diverged as error:
    pd_diverged_at = error.time
    until_then = error.rollout
    print("PD:", error)

# %% [markdown]
# The lecture's script would print numbers past the largest float as if they were results. Here the loop
# stops, and everything recorded before is kept. The forces grow with changing sign from sample to
# sample:

# %%
plots.forces(until_then, title="PD with an offset centre of mass, until it diverges")

# %% [markdown]
# ### Why
#
# With the offset, the loop is $\ddot e \approx -M^{-1}(K_d \dot e + K_p e)$. The matrix $M^{-1} K_d$
# has an eigenvalue $k$ (in 1/s) far above 4: the robot has a direction in which it is very light,
# turning about its centre of mass. A force held for $\Delta t$ overshoots there; it amplifies the error
# when $k\,\Delta t > 2$.

# %%
M = offset.mass_matrix([0, 0, 0])
k_largest = np.linalg.eigvals(np.linalg.solve(M, np.diag([120, 120, 0.4]))).real.max()
print(f"k = {k_largest:.2f} 1/s, so the sampling time must be below {2 / k_largest:.4f} s")
for dt in [0.1, 0.08]:
    try:
        print(f"dt = {dt} s: {simulate(offset, pd, circle, dt=dt)!r}")
    except Diverged as error:
        print(f"dt = {dt} s: {error}")

# %% [markdown]
# ### A robot that can exist
#
# $I_{cz} = 0.1$ kg m² is far too little for a box of 30 kg that measures 0.6 m by 0.4 m: a homogeneous
# one has $m (l^2 + w^2)/12 = 1.3$ kg m². With that, $k$ is small and PD at 0.1 s works. It now errs in
# the heading too: on a circle the offset mass wants to go straight on, and nothing tells PD.

# %%
box = MobileRobot(mass=30, yaw_inertia=1.3, com=(0.1, 0.05))
pd_box = PD((120, 120, 5.2), (120, 120, 5.2))  # 4 times 30 kg and 1.3 kg m²
runs = {
    "PD": simulate(box, pd_box, circle, dt=0.1),
    "computed torque": simulate(box, ComputedTorque(box), circle, dt=0.1),
}
for name, run in runs.items():
    x, y, psi = run.max_error()
    print(f"{name:16} x {1e3 * x:.3f} mm, y {1e3 * y:.3f} mm, psi {1e3 * psi:.3f} mrad")

# %% [markdown]
# ## The wrong model
#
# The controller's robot need not be the simulated one. First, the mass: the robot has 30 kg (and 1.3 kg
# m²), the controller believes in another value $\hat m$. The model then supplies too much or too little
# of the acceleration, by the share $m/\hat m - 1$, and the error is
#
# $$e \approx \left|\frac{m}{\hat m} - 1\right| \frac{r\omega^2}{4} .$$

# %%
believed = np.array([15, 20, 25, 28, 30, 32, 35, 40, 50, 60])  # [kg]
error_wrong_mass = []
for mass in believed:
    model = MobileRobot(mass=mass, yaw_inertia=1.3 * mass / 30, com=(0.1, 0.05))
    error_wrong_mass.append(simulate(box, ComputedTorque(model), circle, dt=0.1).max_error()[0])
estimate = np.abs(30 / believed - 1) * 0.03 / 4

figure, axes = plt.subplots(figsize=(7, 3.4), layout="constrained")
axes.plot(believed, 1000 * estimate, "--", color=colour(2), label="estimate")
axes.plot(believed, 1000 * np.array(error_wrong_mass), "o", color=colour(1), label="computed torque")
axes.axhline(1000 * runs["PD"].max_error()[0], color=colour(0), label="PD")
axes.set(xlabel="mass that the controller believes in [kg]", ylabel="largest error in x [mm]")
axes.set_title("The robot has 30 kg")
axes.legend()
dress(axes)

# %% [markdown]
# With half the mass, computed torque is no better than PD. A model too light costs more than one too
# heavy by the same factor; but the heavier one also has the higher gains, and the sampling time limits
# those.
#
# Second, the centre of mass: the controller believes that it is at the origin.

# %%
centred_box = MobileRobot(mass=30, yaw_inertia=1.3)
runs = {
    "PD": simulate(box, pd_box, circle, dt=0.1),
    "wrong centre of mass": simulate(box, ComputedTorque(centred_box), circle, dt=0.1),
    "right model": simulate(box, ComputedTorque(box), circle, dt=0.1),
}
plots.errors(runs)

# %% [markdown]
# The heading suffers most. The circle asks for the moment $m\,x_{bc}\,r\omega^2 = 0.09$ N m, of which
# this controller knows nothing. So only an error can supply it, of $0.09 / (4 \cdot 1.3) = 0.0173$ rad.
#
# With the lecture's small $I_{cz}$ the same mistake is fatal, for the reason that PD diverged:
# $M^{-1} \hat M K_d$ has the same large eigenvalue, since $\hat M K_d$ is PD's gain.

# %%
try:
    simulate(offset, ComputedTorque(robot), circle, dt=0.1)
    wrong_com_diverged = False
except Diverged as error:
    wrong_com_diverged = True
    print(error)

# %% [markdown]
# ## A controller of your own
#
# Neither controller knows of a steady wind: PD leans on it, with the error $F / k_p$. An integral finds
# its force, but where the input is limited it goes on adding up what cannot be applied, and the robot
# then overshoots: the integral *winds up*. So the part that the limits took away is taken out of it
# again ([back-calculation](https://en.wikipedia.org/wiki/Integral_windup)).
#
# A controller of your own is a frozen dataclass. Each call receives its memory and returns the next one;
# `applied` receives the input after all limits. It runs in `simulate`, and compiled in `ensemble`, without
# change, and a spread may name its numbers, such as `ki`:


# %%
@dataclass(frozen=True)
class PID:
    kp: float = 120.0
    ki: float = 60.0
    kd: float = 120.0
    back: float = 2.0  # [1/s]; 0: the integral winds up

    def initial_state(self, context):
        return {"sum": np.zeros(3), "asked": np.zeros(3), "loop": (context.dt, context.difference)}

    def __call__(self, t, q, v, reference, state):
        dt, difference = state["loop"]
        error = difference(q, reference.q)
        u = self.kp * error + self.kd * (reference.v - v) + state["sum"]
        return u, state | {"sum": state["sum"] + dt * self.ki * error, "asked": u}

    def applied(self, u, state):
        change = state["loop"][0] * self.back * (u - state["asked"])
        return state | {"sum": state["sum"] + change}


# %% [markdown]
# One robot starts 1.5 m beside the circle, in a wind of 15 N, with forces of at most 20 N:

# %%
pushing = {"PD": PD(120, 120), "PID that winds up": PID(back=0.0), "PID": PID()}
beside = {"q0": circle(0).q + np.array([0, -1.5, 0]), "v0": circle(0).v, "duration": 20.0}
windy = {
    name: simulate(
        box, InputSaturation(own, (20, 20, 5)), circle, dt=0.01, forces=[ConstantForce((15, 0, 0))], **beside
    )
    for name, own in pushing.items()
}
plots.errors(windy)

# %% [markdown]
# And two thousand robots, each with a wind and a start of its own:

# %%
calm = ConstantForce((0, 0, 0))  # the spread gives each robot its own
spread = {"force.x": Uniform(-15, 15), "start.y": Uniform(-1.5, 1.5)}
within = {}
for name, own in pushing.items():
    limited = InputSaturation(own, (20, 20, 5))
    fleet = ensemble(box, limited, circle, n=2_000, spread=spread, forces=[calm], dt=0.01, after=8)
    within[name] = fleet.error_quantile(0.99).distance
    print(f"{name:18} {fleet.engine}: 99 % stay within {1e3 * within[name]:.1f} mm from t = 8 s on")

# %% [markdown]
# ## The claim
#
# The lecture's twelve numbers, digit for digit; then, that computed torque is exact with the right
# model wherever the centre of mass lies, that PD diverges as the eigenvalue says, what a wrong model
# costs, and that an integral which does not wind up finds the wind.

# %%
for key, expected in lecture.items():
    assert found[key] == expected, f"not the lecture's numbers: {key}"
assert np.allclose(told.max_error()[:2], [3.491279e-05, 3.491278e-05]), "the offset matters"
assert told.max_error()[2] < 1e-12, "the heading errs"
assert abs(error_ct[1] / error_ct[4] - 10) < 1, "the error of computed torque is not proportional to dt"
assert abs(error_pd[1] / error_pd[4] - 1) < 0.1, "the error of PD depends on dt"
assert pd_diverged_at is not None, "PD does not diverge"
assert 0.08 < 2 / k_largest < 0.1, "the eigenvalue does not tell which sampling time is too long"
assert wrong_com_diverged, "the wrong centre of mass does no harm"
assert np.abs(error_wrong_mass - estimate).max() < 3e-4, "the wrong mass costs something else"
wrong = runs["wrong centre of mass"].max_error()
assert wrong[0] > 5 * runs["right model"].max_error()[0], "the wrong centre of mass costs nothing"
assert abs(wrong[2] / 0.0173 - 1) < 0.05, "the heading errs by something else"
# PD leans on the wind of up to 15 N, and on the circle's inertial force.
assert 0.12 < within["PD"] < 0.135, "PD leans on the wind otherwise"
assert within["PID that winds up"] > 20 * within["PID"], "the integral does not wind up"
assert within["PID"] < 0.01, "the integral does not find the wind"
print("Shown: all twelve numbers are the lecture's; computed torque is as good as its model.")
