"""Drake: a MultibodyPlant on a planar joint; the loop is ours, since its Simulator takes other steps."""

from collections.abc import Callable
from math import remainder, tau
from typing import Any

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import MultibodyForces, PlanarJoint, SpatialInertia, UnitInertia
from task import GAIN, Body, Log, Run, Task, empty, references


def build(body: Body) -> MultibodyPlant:
    plant = MultibodyPlant(time_step=0.0)
    com = np.array([*body.com, 0.0])
    about_origin = UnitInertia(*np.full(3, body.yaw_inertia / body.mass)).ShiftFromCenterOfMass(com)
    link = plant.AddRigidBody("body", SpatialInertia(body.mass, com, about_origin))
    plant.AddJoint(PlanarJoint("planar", plant.world_frame(), link.body_frame(), np.zeros(3)))
    plant.mutable_gravity_field().set_gravity_vector(np.zeros(3))
    plant.Finalize()
    return plant


class Engine:
    """A plant and its context, with the applied force as an array that is written in place."""

    def __init__(self, body: Body) -> None:
        self.plant = build(body)
        self.context = self.plant.CreateDefaultContext()
        port = self.plant.get_applied_generalized_force_input_port()
        self._port_value = port.FixValue(self.context, np.zeros(3))
        self._applied = self._port_value.GetMutableData().get_mutable_value().get_mutable_value()
        self._acceleration = self.plant.get_generalized_acceleration_output_port()
        self._no_force = MultibodyForces(self.plant)
        self._state = np.empty(6)

    def set_state(self, q: np.ndarray, v: np.ndarray) -> None:
        """Hand the state over."""
        self._state[:3], self._state[3:] = q, v
        self.plant.SetPositionsAndVelocities(self.context, self._state)

    def inverse(self, a: np.ndarray) -> np.ndarray:
        """Return M a + n at the state."""
        return self.plant.CalcInverseDynamics(self.context, a, self._no_force)

    def forward(self, force: np.ndarray) -> np.ndarray:
        """Return M^-1 (force - n) at the state."""
        self._applied[:] = force
        self._port_value.GetMutableData()  # says that the value has changed
        return self._acceleration.Eval(self.context)


def rollout(task: Task) -> Run:
    engine = Engine(task.body)
    set_state, inverse, forward = engine.set_state, engine.inverse, engine.forward
    dt, half = task.dt, task.dt**2 / 2

    def run() -> Log:
        QD, VD, AD = references(task)
        Q, V, A, F, E = empty(task)[:5]
        q, v = QD[0], VD[0]
        for k in range(task.samples):
            set_state(q, v)
            e = QD[k] - q
            e[2] = remainder(e[2], tau)
            force = inverse(AD[k] + GAIN * (VD[k] - v + e))
            a = forward(force)
            Q[k], V[k], A[k], F[k], E[k] = q, v, a, force, e
            q = q + dt * v + half * a
            v = v + dt * a
        return Log(Q, V, A, F, E)

    return run


def calls(body: Body) -> dict[str, Callable[..., Any]]:
    engine = Engine(body)
    plant, context = engine.plant, engine.context

    def mass_matrix(q: np.ndarray) -> np.ndarray:
        plant.SetPositions(context, q)
        return plant.CalcMassMatrix(context)

    def nonlinear_effects(q: np.ndarray, v: np.ndarray) -> np.ndarray:
        engine.set_state(q, v)
        return plant.CalcBiasTerm(context)

    def inverse_dynamics(q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
        engine.set_state(q, v)
        return engine.inverse(a)

    def forward_dynamics(q: np.ndarray, v: np.ndarray, force: np.ndarray) -> np.ndarray:
        engine.set_state(q, v)
        return engine.forward(force)

    return {
        "M": mass_matrix,
        "n": nonlinear_effects,
        "inverse": inverse_dynamics,
        "forward": forward_dynamics,
    }
