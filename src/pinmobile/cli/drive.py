"""A robot on wheels drives a path: the controller that fits, what its wheels do, and what the ground does."""

import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from pinmobile import (
    ComputedTorque,
    Diverged,
    InvalidArgument,
    MobileRobot,
    Rollout,
    UnknownName,
    VelocityCommand,
    VelocityRobot,
    plots,
    rk4,
    simulate,
)
from pinmobile.arrays import Array, positive, wrap_angle
from pinmobile.cli.choices import DEFAULT_PRESET, DRIVEN, DRIVES, HEADINGS, OF_SPEEDS, Choice, velocity_robot
from pinmobile.cli.options import LECTURE, Options, as_option, choose, moved, numbers
from pinmobile.cli.output import (
    Picture,
    Section,
    begin,
    console,
    index_page,
    output_folder,
    progress,
    save_figure,
)
from pinmobile.cli.run import FIGURES, draw
from pinmobile.controllers import Backstepping, Controller, State, Tracking
from pinmobile.measures import in_words
from pinmobile.parts import Stepping, able
from pinmobile.trajectories import Trajectory
from pinmobile.wheels import Coulomb, Friction, Mobility, Motor, WheeledRobot

_MASS, _SIZE = 30.0, (0.6, 0.4, 0.25)  # of the whole [kg], and of the box above the wheels [m]
_WHEEL_MASS, _WIDTH = 1.0, 0.45  # [kg], and in radii
_G = 9.81  # [m/s^2]
_GAINS = 25.0, 10.0
_SLIP = (
    1e-4  # [m/(N s)] before a wheel slides, as tyres have; it tells how wheels share what is not determined
)
_TOLERANCE = 1e-6  # of friction: such forces are drawn, not compared
_STANDS = 0.02  # [m/s]: a slower wheel is not steered
_FIGURES = {
    "wheel_torques": "Torques of the wheels, and of what steers them.",
    "friction": "Force at each wheel as a share of the friction that it has: at 1 it slides.",
    "slip": "Velocity of each wheel over the ground, along and across.",
    "loads": "What each wheel carries.",
}


class OfFile(NamedTuple):
    """Where a robot on wheels is read from.

    Attributes
    ----------
    path : Path
        The URDF.
    package_dirs : tuple of Path
        Where its ``package://`` is.
    rollers : str or None
        Angle of its wheels' rollers [rad], or ``"none"`` of tyres.
    """

    path: Path
    package_dirs: tuple[Path, ...] = ()
    rollers: str | None = None


def wheeled_of(
    typed: Mapping[str, Any],
    name: str | None,
    file: OfFile | None = None,
    *,
    mu: float | None = None,
    arms: Sequence[str] = (),
) -> WheeledRobot:
    """Return the robot on wheels that was asked for.

    Parameters
    ----------
    typed : mapping of str to any
        Numbers of the drive by option, None where nothing was typed.
    name : str or None
        Of the drive.
    file : OfFile, optional
        A file in its place.
    mu : float, optional
        Coefficient of friction; by default wheels roll where they can.
    arms : sequence of str
        Names of arms on it.

    Raises
    ------
    InvalidArgument, UnknownName
        If neither or both are given, or an option is not what is expected.
    """
    ground = None if mu is None else Coulomb(mu, tolerance=_TOLERANCE)
    given = {option: typed.get(option) for choice in DRIVES.values() for option in choice.takes}
    if file is not None:
        if name is not None:
            raise InvalidArgument(f"--urdf stands for a drive, but there is {name!r} too")
        _refuse(given, (), "does not apply beside --urdf")
        more: dict[str, Any] = {}
        if file.rollers is not None:
            tyres = file.rollers.strip().lower() == "none"
            more["rollers"] = {} if tyres else _one("--rollers", file.rollers)
            ground = ground or (Coulomb(tolerance=_TOLERANCE) if tyres else None)
        with LECTURE.naming("urdf", path="urdf"):
            try:
                return WheeledRobot.from_urdf(file.path, file.package_dirs, ground=ground, **more)
            except InvalidArgument as error:
                if more or "rollers is not given" not in str(error):
                    raise
                raise InvalidArgument(
                    f"--urdf is {str(file.path)!r}, whose wheels are on more than one axle, and the file "
                    "does not say whether they have rollers: give --rollers 0.785 for mecanum wheels, or "
                    "--rollers none for tyres, which skid in turns",
                    argument="",
                ) from error
    if name is None:
        raise InvalidArgument(
            "drive needs a drive: 'pinmobile drive mecanum --html out/mecanum.html', or a file by --urdf; "
            f"available: {', '.join((*DRIVES, *OF_SPEEDS))}",
            argument="",
        )
    if name not in DRIVES:
        raise UnknownName("drive", name, (*DRIVES, *OF_SPEEDS))
    choice = DRIVES[name]
    _refuse(
        given,
        choice.takes,
        f"does not apply to {name}, which takes {', '.join(map(as_option, choice.takes))}",
    )
    return _box_on(choice, given, ground, arms)


def _one(option: str, text: str) -> float:
    (found,) = numbers(option, text)[:1]
    return found


def velocity_robot_of(typed: Mapping[str, Any], preset: str | None, theta: str | None) -> VelocityRobot:
    """Return the robot that takes speeds for commands that was asked for.

    Parameters
    ----------
    typed : mapping of str to any
        Numbers of drives by option, which do not apply.
    preset : str or None
        Of a published one; by default, where there is no theta either, that of the Pioneer 3-DX with a laser.
    theta : str or None
        Six numbers with commas.
    """
    wheels = {option: typed.get(option) for choice in DRIVES.values() for option in choice.takes}
    _refuse(wheels, (), "does not apply to velocity, which takes --preset or --theta")
    if preset is not None and theta is not None:
        raise InvalidArgument("--theta stands in place of --preset, but there are both")
    if theta is not None:
        return velocity_robot(theta=numbers("--theta", theta))
    return velocity_robot(DEFAULT_PRESET if preset is None else preset)


def _refuse(given: Mapping[str, Any], taken: Any, why: str) -> None:
    for option, value in given.items():
        if value is not None and option not in taken:
            raise InvalidArgument(f"{as_option(option)} {why}")


def _box_on(
    choice: Choice[Any], given: Mapping[str, Any], ground: Coulomb | None, arms: Sequence[str]
) -> WheeledRobot:
    numbers: dict[str, Any] = {
        option: choice.takes[option] if given[option] is None else given[option] for option in choice.takes
    }
    radius = positive("--wheel-radius", numbers["wheel_radius"], "m")
    called = {option: argument for argument, option in choice.called.items()}
    wheel: dict[str, Any] = {
        "mass": _WHEEL_MASS,
        "spin_inertia": _WHEEL_MASS * radius**2 / 2,
        "yaw_inertia": _WHEEL_MASS * radius**2 * (3 + _WIDTH**2) / 12,
        "friction": Friction(slip=_SLIP),
    }
    made = {called.get(name, name): value for name, value in numbers.items()}
    try:
        table = choice.make(**made, **wheel)
        if ground is not None and ground.mu:  # motors as strong as the ground holds, which spin no wheel up
            driving = sum(any(each.column[len(table.axes) :]) for each in table.actuators)
            limit = ground.mu * _MASS * _G * radius / driving
            table = choice.make(**made, **wheel, motor=Motor(torque_limit=limit))
    except InvalidArgument as error:
        option = choice.called.get(error.argument, error.argument)
        raise error.calling(as_option(option)) if option in numbers else error from None
    # The car's axle is below its rear, and the body's middle ahead of it.
    com = (sum(w.x for w in table.wheels) / len(table), 0.0, _SIZE[2] / 2)
    inertia = _MASS * (_SIZE[0] ** 2 + _SIZE[1] ** 2) / 12
    robot = MobileRobot(_MASS, inertia, com=com, size=_SIZE)
    for arm in arms:
        robot = robot.mount(arm)
    if ground is None and not Mobility.of(table).is_regular:
        ground = Coulomb(tolerance=_TOLERANCE)
    return WheeledRobot(robot, table, ground)


def trajectory_of(options: Options) -> Trajectory:
    """Return what the options of a path stand for."""
    name = options["trajectory"]
    path = choose("trajectory", name, DRIVEN)
    others = [each for kind in DRIVEN.values() for each in kind.takes if each not in path.takes]
    options.refuse(others, f"does not apply to the trajectory {name!r}")
    heading = choose("heading", options["heading"], HEADINGS)
    return options.made("heading", heading, moved(options, options.made("trajectory", path)))


def controller_of(robot: WheeledRobot | VelocityRobot) -> tuple[Controller, str]:
    """Return the controller that fits a drive, and what it is called."""
    if isinstance(robot, VelocityRobot):
        return Backstepping(Tracking(), robot), "tracking by backstepping"
    m, s = robot.mobility.mobility, robot.mobility.steerability
    if robot.mobility.is_regular and m == 3:
        return ComputedTorque(robot, *_GAINS), "computed torque"
    if robot.mobility.is_regular and (m, s) in ((2, 0), (1, 1)):
        return Backstepping(Tracking(), robot), "tracking by backstepping"
    return _WheelRates(robot), "wheel speeds"


@dataclass(frozen=True, eq=False)
class _WheelRates:
    """Wheels turn, and steer, as those of the body twist that is wanted would, by proportional torques.

    The twist is the reference's, and what errors of the pose add to it; where no wheel steers, what is beside
    the path adds to the yaw rate, and turns need as much more as skidding takes: 1 + (lx / b)^2, see
    Mandow et al., IROS 2007.
    """

    robot: WheeledRobot
    ahead: float = 2.0  # [1/s]
    turn: float = 3.0  # [1/s]
    aside: float = 6.0  # [1/(m s)], of the yaw rate
    rate: float = 30.0  # [1/s], of the wheels
    sums: float = 8.0  # [1/s], of what rates have been missed by
    steer: float = 20.0  # [1/s], of steering angles
    more: float = field(init=False)

    def __post_init__(self) -> None:
        x, y = np.array([wheel.centre for wheel in self.robot.table.wheels]).T
        skids = not self.robot.table.axes and np.ptp(y) > 0
        object.__setattr__(self, "more", 1 + (np.ptp(x) / np.ptp(y)) ** 2 if skids else 1.0)

    def initial_state(self, context: Any) -> tuple[float, Array]:
        """Return the time between samples, and what rates have been missed by, summed up, shape (wheels,)."""
        return float(context.dt), np.zeros(len(self.robot.table))

    def __call__(
        self, t: float, q: Array, v: Array, reference: State, state: tuple[float, Array]
    ) -> tuple[Array, tuple[float, Array]]:
        """Return the torques, shape (nu,), and the next state."""
        robot, nv = self.robot, self.robot.robot.nv
        axes = len(robot.table.axes)
        c, s = np.cos(q[2]), np.sin(q[2])
        ex, ey = reference.q[:2] - q[:2]
        error = np.array([c * ex + s * ey, c * ey - s * ex, float(wrap_angle(reference.q[2] - q[2]))])
        ahead = np.array([c * reference.v[0] + s * reference.v[1], c * reference.v[1] - s * reference.v[0]])
        twist = np.array([*(ahead + self.ahead * error[:2]), reference.v[2] + self.turn * error[2]])
        if not axes:
            twist[1], twist[2] = 0.0, (twist[2] + self.aside * ahead[0] * error[1]) * self.more
        angles, turning = q[nv : nv + axes], v[nv : nv + axes]
        off = (self._steered_to(twist, angles) - angles + np.pi / 2) % np.pi - np.pi / 2
        missed = robot.wheel_rates(twist, angles, turning) - v[nv + axes :]
        M = np.diagonal(robot.mass_matrix(q))[nv:]
        steering = M[:axes] * self.steer * (self.steer * off - 2 * turning)
        dt, summed = state
        summed = summed + dt * missed
        forces = np.concatenate([steering, self._driven() * (missed + self.sums * summed)])
        return np.asarray(robot.input_matrix[nv:].T @ forces), (dt, summed)

    def _steered_to(self, twist: Array, angles: Array) -> Array:
        """Return the angles at which wheels go where the body takes them; where they stand, those of now."""
        found = angles.copy()
        for k, axis in enumerate(self.robot.table.axes):
            wheel = self.robot.table.wheels[axis.wheels[0]]
            ahead, aside = twist[0] - twist[2] * wheel.y, twist[1] + twist[2] * wheel.x
            if np.hypot(ahead, aside) > _STANDS:
                found[k] = np.arctan2(aside, ahead) - wheel.angle
        return found

    def _driven(self) -> float:
        """Return torque per rate of a wheel [N m s/rad], of a mass that the wheels share."""
        robot, radius = self.robot, float(np.mean(self.robot.radius))
        total = sum(float(inertia.mass) for inertia in robot.robot.model.inertias)
        return 0.3 * self.rate * total * radius**2 / len(robot.table.actuators)


def show_drive(
    typed: Mapping[str, Any],
    robot: WheeledRobot | VelocityRobot,
    name: str,
    *,
    dt: float,
    html: Path | None,
    out: Path | None,
) -> int:
    """Drive the path, print what the wheels did, and write the page and the figures that were asked for."""
    folder = None if out is None else output_folder(out)
    if html is not None:
        if html.suffix != ".html":
            raise InvalidArgument(f"--html is {str(html)!r}, expected a file that ends in .html")
        output_folder(html.parent, "--html", html)
    options = LECTURE.with_values(**dict(typed))
    reference = trajectory_of(options)
    controller, called = controller_of(robot)
    failed: Diverged | None = None
    of_wheels = _FIGURES if hasattr(robot, "contacts") else {}
    figures = len(FIGURES) + len(of_wheels) + 1 if folder is not None else 0
    with progress(1 + (html is not None) + figures) as bar:
        begin(bar, "simulating")
        own: dict[str, Any] = {} if able(robot, Stepping) else {"integrator": rk4}
        try:
            run = simulate(robot, controller, reference, dt=dt, **own)
        except Diverged as error:
            if error.rollout is None:
                raise
            failed, run = error, error.rollout
        rows = _judged(run)
        if isinstance(robot, VelocityRobot):
            plain = simulate(robot, VelocityCommand(Tracking(), robot), reference, dt=dt)
            rows["the same, speeds of the law as commands [m]"] = _farthest(plain)
        told = [f"{words:44} {in_words(value):>12}" for words, value in rows.items()]
        text = "\n".join([_head(robot, name, called), "", *told])
        if html is not None:
            begin(bar, "recording the scene")
            _save_page(run, html, f"{name}: {called}")
        page = None
        if folder is not None:
            begin(bar, "recording")
            run.save(folder / "rollout.npz")
            run.to_csv(folder / "rollout.csv")
            pictures = draw({called: run}, folder, "", bar)
            for figure, caption in of_wheels.items():
                begin(bar, f"drawing {figure}")
                save_figure(getattr(plots, figure)(run), folder / f"{figure}.png")
                pictures.append(Picture(f"{figure}.png", caption))
            page = index_page(folder, f"{name}: {called}", [Section("Results", text, pictures)])
    console.print(text, markup=False)
    for line in _next(html, page):
        console.print(line, markup=False)
    if failed is not None:
        raise failed
    return 0


def _save_page(run: Rollout, path: Path, title: str) -> None:
    from pinmobile.viewer import Overlays, Viewer

    wheels = hasattr(run.plant, "contacts")
    with Viewer(run.plant, overlays=Overlays(contacts=wheels, centre=wheels)) as viewer:
        viewer.record(run, title=title).save_html(path)


def _head(robot: WheeledRobot | VelocityRobot, name: str, called: str) -> str:
    if isinstance(robot, VelocityRobot):
        told = ", ".join(f"{x:g}" for x in robot.theta)
        late = " and ".join(f"{x:.3g} s" for x in robot.time_constants)
        lines = [
            f"{name}: firmware follows speed and yaw rate late by {late}; {called}",
            f"theta = {told}",
            *textwrap.wrap(robot.source or ". ".join(robot.problems), 79),
        ]
        return "\n".join(lines)
    ground = robot.ground
    stands = "rolling without slip"
    if ground.slips:
        coefficients = sorted({float(mu) for mu in robot.mu})
        stands = f"dry friction, mu = {', '.join(f'{mu:g}' for mu in coefficients)}"
    return f"{name}: {stands}; {called}\n{robot.mobility}"


def _farthest(run: Rollout) -> float:
    return float(np.hypot(*run.error[:, :2].T).max())


def _judged(run: Rollout) -> dict[str, float]:
    """Return what is to be told of a run: errors, commands, or torques, friction, slip and loads."""
    plant: Any = run.plant
    rows = {
        "largest error in place [m]": _farthest(run),
        "error at the end [m]": float(np.hypot(*run.error[-1, :2])),
    }
    if not hasattr(plant, "contacts"):
        most = np.abs(run.u).max(axis=0)
        told = {f"largest {one.name} [{one.unit}]": x for one, x in zip(run.inputs, most, strict=True)}
        return rows | {words: float(x) for words, x in told.items()}
    found = plant.contacts(run.q, run.v, run.a, run.u, run.signals)
    used = plots.share_of_friction(found)
    rows["largest torque of a wheel [N m]"] = float(np.abs(run.u[:, plant.robot.nv - 3 :]).max())
    rows["largest force of a wheel [N]"] = float(np.linalg.norm(found.forces, axis=-1).max())
    if np.isfinite(used).any():
        rows["largest share of friction [-]"] = float(np.nanmax(used))
        rows["least load of a wheel [N]"] = float(np.nanmin(found.loads))
    if "slides" in run.signals:
        rows["share of time at which a wheel slides [-]"] = float(found.slides.any(axis=1).mean())
    return rows


def _next(html: Path | None, page: Path | None) -> list[str]:
    lines = []
    if html is not None:
        lines += [f"recording: {html.stat().st_size / 1e6:.1f} MB", f"see it move: open {html}"]
    if page is not None:
        lines.append(f"figures and records: open {page}")
    return lines or ["see it move: add --html out/drive.html; figures and records: add --out out/drive"]
