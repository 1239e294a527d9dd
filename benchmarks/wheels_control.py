"""A figure of eight on a differential drive whose motors take volts: backstepping, LQR and MPC side by side.

Usage: python benchmarks/wheels_control.py [--quick] [--rounds N] [--only WORD ...]

The eight is 1 m sin 0.5 t, 0.5 m sin t, for 25 s, sampled at 100 Hz, for which the model needs 5.7 V of
the 6 V that there are. What follows it is as the model, or 20 % heavier, on ground with dry friction of 0.3,
where it would need 6.2 V; it starts on the eight, or at rest 0.3 m behind and 0.3 m beside it. Errors are
those after 5 s; the limit counts where one motor is at it. MPC takes the volts for its limits; or, of
torques, four fifths of what friction holds under the lightest wheel along the eight, so that none slips. With
--quick, 8 s, of which MPC is left out.
"""

import sys
from collections.abc import Mapping, Sequence
from time import process_time
from typing import Any

import numpy as np
from measuring import selecting

import pinmobile as pm

DT, SECONDS, AFTER = 0.01, 25.0, 5.0
VOLTS = 6.0
OFF = np.array([-0.3, -0.3, 0.0, 0.0, 0.0])
MOTOR = pm.wheels.Motor(
    resistance=1.2,
    torque_constant=0.03,
    voltage=VOLTS,
    gear=20.0,
    rotor_inertia=1e-5,
    viscous=1e-5,
    coulomb=0.004,
    efficiency=0.8,
)
TABLE = pm.WheelTable.differential(
    0.5,
    0.1,
    motor=MOTOR,
    supports=[(-0.2, 0.0), (0.2, 0.0)],
    friction=pm.wheels.WheelFriction(mu=0.3),
    mass=1.0,
    spin_inertia=0.01,
    yaw_inertia=0.006,
)
MODEL = pm.WheeledRobot(pm.MobileRobot(30.0, 2.3, com=(0.05, 0.0, 0.2)), TABLE)
HEAVY = pm.WheeledRobot(pm.MobileRobot(36.0, 2.76, com=(0.05, 0.0, 0.2)), TABLE, pm.Coulomb())


class Eight:
    """The path."""

    duration = SECONDS

    def __call__(self, t: Any) -> Any:
        """Return x and y [m]."""
        return self.derivative(t, 0)

    def derivative(self, t: Any, order: int) -> Any:
        """Return a derivative of both."""
        rate, size = np.array([0.5, 1.0]), np.array([1.0, 0.5])
        return size * rate**order * np.sin(rate * np.asarray(t)[..., None] + order * np.pi / 2)


EIGHT = pm.Tangent(Eight())


def held(follower: Any) -> float:
    """Return the torque [N m] that friction holds along the eight, a fifth of it kept back."""
    along = run(MODEL, follower, 0 * OFF, SECONDS, pm.Engine.COMPILED)
    driven = [one for one in TABLE.wheels if one.motor is not None]
    least = pm.balance.contact_loads(along).values[:, : len(driven)].min(axis=0)
    return 0.8 * min(one.friction.mu * N * one.radius for one, N in zip(driven, least, strict=True))


def controllers() -> Mapping[str, Any]:
    """Return controllers, each of the model: LQR and MPC of its volts, or of torques that motors give."""
    volts = MODEL.by_voltage()
    follower = pm.controllers.TorqueToVoltage(pm.Backstepping(pm.UnicycleTracking(), MODEL), volts)
    return {
        "backstepping": follower,
        "LQR, torques": pm.controllers.TorqueToVoltage(pm.LQR(MODEL), volts),
        "LQR, volts": pm.LQR(volts),
        "MPC, volts": pm.MPC(volts),
        "MPC, friction": pm.controllers.TorqueToVoltage(pm.MPC(MODEL, limits=held(follower)), volts),
    }


def run(robot: Any, controller: Any, off: Any, seconds: float, engine: Any) -> pm.Rollout:
    """Return how a robot follows the eight."""
    q, v = MODEL.start(EIGHT(0.0))
    given = {
        "dt": DT,
        "duration": seconds,
        "engine": engine,
        "q0": q + off,
        "v0": v if not off.any() else 0 * v,
    }
    return pm.simulate(robot.by_voltage(), controller, EIGHT, **given)


def told(found: pm.Rollout) -> str:
    """Return a row of numbers."""
    distance = 1e3 * np.hypot(*(found.q[:, :2] - found.reference.q[:, :2]).T)[found.t >= AFTER]
    volts = np.abs(found.u)
    chatter = np.abs(np.diff(found.u, axis=0)).sum(axis=0).max() / found.t[-1]
    limited = 100 * (volts >= VOLTS * (1 - 1e-9)).any(axis=-1).mean()
    slips = [found.signals[name].values for name in ("slip_along", "slip_across") if name in found.signals]
    slip = 1e3 * np.hypot(*slips).max() if slips else 0.0
    return (
        f"{np.sqrt((distance**2).mean()):7.2f} {distance.max():8.2f} {np.sqrt((found.u**2).mean()):7.2f} "
        f"{chatter:8.1f} {limited:7.1f} {slip:7.1f}"
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table, one block for each robot and start."""
    quick = selecting(__doc__.splitlines()[0]).parse_args(arguments).quick
    every = {name: each for name, each in controllers().items() if not (quick and "MPC" in name)}
    for words, robot in (("as the model", MODEL), ("20 % heavier, friction 0.3", HEAVY)):
        for start, off in (("on the eight", 0 * OFF), ("0.3 m behind and beside", OFF)):
            print(f"a robot {words}, which starts {start}")
            print("                 rms mm   max mm   rms V  chat V/s  limit % slip mm/s    s")
            for name, controller in every.items():
                begin, engine = process_time(), None if "MPC" in name else pm.Engine.COMPILED
                row = told(run(robot, controller, off, 8.0 if quick else SECONDS, engine))
                print(f"  {name:13} {row} {process_time() - begin:6.1f}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
