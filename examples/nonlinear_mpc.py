"""Nonlinear model predictive control by crocoddyl, as a controller of pinmobile, beside `MPC`.

Usage: python examples/nonlinear_mpc.py        (after: pip install crocoddyl)

Over a horizon it makes the sum of e' Q e + du' R du least within limits of the input, by differential dynamic
programming (Mastalli et al., 2022), on the robot's own Pinocchio model. Three traps:

- nthreads = 1: else crocoddyl's threads spin on every processor: up to 100 times as long.
- Euler with a small step: IntegratedActionModelRK compares all its stages with one reference, which moves.
- The model's angle is not on the circle: the reference is taken in the turn in which the robot is.
"""

import sys
from dataclasses import dataclass
from time import process_time
from typing import Any, NamedTuple

import numpy as np

import pinmobile as pm
from pinmobile.plant import Context

ORDER = [1, 0, 2]  # Pinocchio's chain is (y, x, psi)
WEIGHTS = (400.0, 400.0, 100.0, 20.0, 20.0, 5.0), (1e-3, 1e-3, 2e-2)  # those of `LQR`, of state and input


class Workspace(NamedTuple):
    """What a solver writes into; no answer hangs on what earlier ones left there, and a copy is itself."""

    solver_of: Any
    problem: Any
    compared: Any

    def __deepcopy__(self, memo: Any) -> "Workspace":
        return self


@dataclass(frozen=True)
class NonlinearMPC:
    """A pushed body's nonlinear predictive controller.

    Parameters
    ----------
    robot : MobileRobot
        The model, without arms.
    limits : tuple of float
        Largest forces [N, N, N m].
    horizon : int
        Steps that are predicted.
    step : float
        Each of them, a whole number of samples [s].
    iterations : int
        Of the solver at a sample, which begins with the solution of the one before.
    """

    robot: pm.MobileRobot
    limits: tuple[float, float, float]
    horizon: int = 50
    step: float = 0.02
    iterations: int = 4

    def initial_state(self, context: Context) -> Any:
        """Return the problem, the reference, the sample's number and the last solution."""
        import crocoddyl

        state = crocoddyl.StateMultibody(self.robot.model)
        motors = crocoddyl.ActuationModelFull(state)
        nodes, compared = [], []
        for j in range(self.horizon + 1):
            costs = crocoddyl.CostModelSum(state)
            residuals = crocoddyl.ResidualModelState(state), crocoddyl.ResidualModelControl(state)
            for name, residual, own in zip(("state", "input"), residuals, WEIGHTS, strict=True):
                activation = crocoddyl.ActivationModelWeightedQuad(2 * np.array(own))
                costs.addCost(name, crocoddyl.CostModelResidual(state, activation, residual), 1.0)
            law = crocoddyl.DifferentialActionModelFreeFwdDynamics(state, motors, costs)
            node = crocoddyl.IntegratedActionModelEuler(law, self.step if j < self.horizon else 0.0)
            node.u_lb, node.u_ub = -np.array(self.limits), np.array(self.limits)
            nodes.append(node)
            compared.append(residuals)
        problem = crocoddyl.ShootingProblem(np.zeros(6), nodes[:-1], nodes[-1])
        problem.nthreads = 1
        stride = round(self.step / context.dt)
        t = context.t[0] + context.dt * np.arange(len(context.t) + stride * self.horizon)
        q, v, a = context.trajectory(np.minimum(t, context.trajectory.duration))
        x = np.concatenate([q[:, ORDER], v[:, ORDER]], axis=-1)
        along = x, self.robot.inverse_dynamics(q, v, a)[:, ORDER], stride
        return Workspace(crocoddyl.SolverBoxFDDP, problem, compared), along, 0, None

    def __call__(self, t: float, q: Any, v: Any, reference: Any, state: Any) -> tuple[Any, Any]:
        """Return the force, shape (3,), and the next state."""
        (solver_of, problem, compared), (x, u, stride), k, found = state
        here, turn = np.concatenate([q[ORDER], v[ORDER]]), np.zeros(6)
        turn[2] = 2 * np.pi * np.round((q[2] - reference.q[2]) / (2 * np.pi))
        at = slice(k, k + stride * self.horizon + 1, stride)
        for (place, force), own, push in zip(compared, x[at] + turn, u[at], strict=True):
            place.reference, force.reference = own, push
        problem.x0 = here
        solver = solver_of(problem)  # a used one begins with the gains that it found
        states, inputs = found or ([here] * len(compared), list(u[at][:-1]))
        solver.solve([here, *states[1:]], inputs, self.iterations, False)
        found = [np.array(each) for each in solver.xs], [np.array(each) for each in solver.us]
        return found[1][0][ORDER], (state[0], (x, u, stride), k + 1, found)


def main() -> None:
    """Start beside a circle, with 22 N and 3 N m, and print how long it takes to come within 20 mm of it."""
    try:
        import crocoddyl  # noqa: F401
    except ImportError:
        sys.exit("this example needs crocoddyl, which is not installed: pip install crocoddyl")
    robot = pm.MobileRobot(mass=30, yaw_inertia=1.3, com=(0.1, 0.05))
    circle, limits = pm.Tangent(pm.Circle(radius=1.5, rate=0.6, duration=10)), (22.0, 22.0, 3.0)
    start = circle(0.0).q + np.array([-0.3, -0.5, 0.4])
    given = {"dt": 0.01, "duration": 6.0, "q0": start, "integrator": pm.rk4, "substeps": 4}
    for controller in (NonlinearMPC(robot, limits), pm.MPC(robot, limits=limits, observer=0)):
        begin = process_time()
        run = pm.simulate(robot, controller, circle, v0=circle(0.0).v, **given)
        spent = 1e3 * (process_time() - begin) / len(run.t)
        off = 1e3 * np.linalg.norm((run.q - run.reference.q)[:, :2], axis=-1)
        print(
            f"{type(controller).__name__:12} within 20 mm after {run.t[off > 20][-1]:.2f} s, "
            f"{off[run.t >= 5].max():.2f} mm after 5 s; inputs up to {np.abs(run.u).max(axis=0).tolist()}; "
            f"{spent:.2f} ms a sample"
        )


if __name__ == "__main__":
    main()
