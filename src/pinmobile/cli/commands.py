"""The commands and their options."""

from pathlib import Path
from typing import Annotated, Any

import typer

import pinmobile
from pinmobile import InvalidArgument
from pinmobile.cli import choices
from pinmobile.cli.demonstration import mounted
from pinmobile.cli.lecture import show_lecture
from pinmobile.cli.mount import list_mountable, show_mount
from pinmobile.cli.output import console, output_folder, progress
from pinmobile.cli.run import show_run
from pinmobile.cli.view import chosen_runs, overlays_of, saved_runs, show_live
from pinmobile.plant import parameters_of

__all__ = ["app"]

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode="rich",
    pretty_exceptions_enable=False,
    help="Dynamics and control of ground robots on Pinocchio. Start with [bold]pinmobile lecture[/bold].",
    epilog="Exit codes: 0 done; 1 done, and the answer is no, or the system failed, as of a full disk; "
    "2 options or files are wrong; 130 interrupted.",
)

_ROBOT, _PATH, _CONTROL, _LOOP = "Robot", "Trajectory", "Controller", "Loop and output"
_UNITS = choices.UNITS
Text = str | None
Number = float | None
_GROUND = "z of the ground in the root link's frame (m); what the file tells"


def _of_path(name: str) -> Any:
    """Return the option of what paths take: which, what it is, its unit, and the lecture's number."""
    kinds = {kind: (make, given[name]) for kind, (make, given) in choices.PATHS.items() if name in given}
    stated = [each for make, _ in kinds.values() for each in parameters_of(make) if each.attribute == name]
    meaning = stated[0].meaning.split(", ")[0] if stated else f"{name} of the path"
    unit = stated[0].unit if stated else choices.UNITS[name]
    value = next(iter(kinds.values()))[1]
    several = isinstance(value, tuple)
    told = ",".join(f"{each:g}" for each in (value if several else (value,)))
    which = "" if len(kinds) == len(choices.PATHS) else f"{', '.join(kinds)}: "
    text = f"{which}{meaning}{' X,Y' if several else ''} ({unit}); {told}."
    return typer.Option(help=text[0].upper() + text[1:] if not which else text, rich_help_panel=_PATH)


def _version(wanted: bool) -> None:
    if wanted:
        console.print(f"pinmobile {pinmobile.__version__}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", help="Print the version.", callback=_version, is_eager=True)
    ] = False,
) -> None:
    pass


@app.command()
def lecture(
    out: Annotated[Path, typer.Option(help="Folder for the figures and their index page.")] = Path("out"),
    gif: Annotated[bool, typer.Option(help="Also draw the moving robot.")] = True,
) -> int:
    """Work through the whole lecture: derive, verify, run, and draw.

    It derives M(q) and n(q, v) from the Denavit-Hartenberg table, compares five routes to them, runs
    {via stop, via free, circle} x {PD, computed torque} with the lecture's numbers, prints the largest
    errors beside the lecture's, and writes every figure with an index page.
    """
    return show_lecture(output_folder(out), gif=gif)


@app.command()
def verify(
    urdf: Annotated[
        Path | None, typer.Option(help="Verify the robot of this URDF: the chain, or a bare base.")
    ] = None,
    ground: Annotated[Number, typer.Option(help=f"Beside --urdf: {_GROUND}.")] = None,
    mass: Annotated[Number, typer.Option(help="Mass (kg); 10.")] = None,
    yaw_inertia: Annotated[
        Number, typer.Option(help="Inertia about the centre of mass (kg m^2); 1.2.")
    ] = None,
    com: Annotated[Text, typer.Option(help="Centre of mass X,Y in the body frame (m); 0.15,0.05.")] = None,
    table: Annotated[Text, typer.Option(help="DH table: lecture or slide; lecture.")] = None,
    mount: Annotated[
        list[str] | None, typer.Option(help="Arm on it, as of `pinmobile mount`; repeat it.")
    ] = None,
    states: Annotated[int, typer.Option(help="Number of random states.")] = 200,
    seed: Annotated[int, typer.Option(help="Seed of the states.")] = 0,
) -> int:
    """Compare closed form, Pinocchio, symbolic Newton-Euler, Lagrange and machine code: M, n, tau, a.

    With an arm on it (--mount ur5), Pinocchio's algorithms against each other, against Newton's and Euler's
    laws for its parts and against machine code, and the base against the closed form.
    """
    if urdf is None:
        choices.refuse_without("--urdf", ground=ground)
    if mount:
        own = {"mass": mass, "yaw_inertia": yaw_inertia, "com": com, "table": table}
        choices.refuse_beside("--mount", urdf=urdf, **own)
        robot = mounted(mount)
    elif urdf is not None:
        choices.refuse_beside("--urdf", mass=mass, yaw_inertia=yaw_inertia, com=com, table=table)
        robot = pinmobile.MobileRobot.from_urdf(urdf, ground=ground)
    else:
        dh = choices.choose("table", table or "lecture", choices.TABLES)
        parameters = 10.0 if mass is None else mass, 1.2 if yaw_inertia is None else yaw_inertia
        robot = pinmobile.MobileRobot(*parameters, com=choices.point("--com", com or "0.15,0.05"), dh=dh)
    with progress(1) as bar:
        bar.update(bar.task_ids[0], description="deriving and comparing")
        verification = pinmobile.verify(robot, states=states, seed=seed)
    console.print(f"{robot.source}: {robot}", markup=False)
    console.print(str(verification), markup=False)
    console.print("every route agrees" if verification.passed else "the routes do NOT agree")
    return 0 if verification.passed else 1


@app.command()
def derive(
    table: Annotated[str, typer.Option(help="DH table: lecture or slide.")] = "lecture",
    latex: Annotated[bool, typer.Option("--latex", help="Print LaTeX instead of text.")] = False,
) -> int:
    """Derive the equations of motion from the DH table, every step of the lecture's symbolic script."""
    dh = choices.choose("table", table, choices.TABLES)
    with progress(1) as bar:
        bar.update(bar.task_ids[0], description="deriving")
        derivation = pinmobile.derivation.lecture(dh)
    console.print(derivation.latex() if latex else str(derivation), markup=False)
    return 0


@app.command()
def run(
    trajectory: Annotated[
        str, typer.Option(help=f"One of {', '.join(choices.PATHS)}.", rich_help_panel=_PATH)
    ] = "circle",
    duration: Annotated[Number, _of_path("duration")] = None,
    radius: Annotated[Number, _of_path("radius")] = None,
    rate: Annotated[Number, _of_path("rate")] = None,
    rx: Annotated[Number, _of_path("rx")] = None,
    ry: Annotated[Number, _of_path("ry")] = None,
    wx: Annotated[Number, _of_path("wx")] = None,
    wy: Annotated[Number, _of_path("wy")] = None,
    start: Annotated[Text, _of_path("start")] = None,
    via: Annotated[Text, _of_path("via")] = None,
    end: Annotated[Text, _of_path("end")] = None,
    t_via: Annotated[Number, _of_path("t_via")] = None,
    via_velocity: Annotated[Text, _of_path("via_velocity")] = None,
    heading: Annotated[
        str, typer.Option(help=f"One of {', '.join(choices.HEADINGS)}.", rich_help_panel=_PATH)
    ] = "tangent",
    psi: Annotated[
        Number, typer.Option(help=f"fixed: heading ({_UNITS['psi']}); 0.", rich_help_panel=_PATH)
    ] = None,
    turn_time: Annotated[
        float,
        typer.Option(
            help=f"For each turn on the spot, where the tangent jumps ({_UNITS['turn_time']}).",
            rich_help_panel=_PATH,
        ),
    ] = 2.0,
    controller: Annotated[
        str, typer.Option(help="computed-torque or pd.", rich_help_panel=_CONTROL)
    ] = "computed-torque",
    kp: Annotated[
        Text, typer.Option(help="K or KX,KY,KPSI; 4, for pd 120,120,0.4.", rich_help_panel=_CONTROL)
    ] = None,
    kd: Annotated[
        Text, typer.Option(help="K or KX,KY,KPSI; 4, for pd 120,120,0.4.", rich_help_panel=_CONTROL)
    ] = None,
    model_mass: Annotated[
        Number,
        typer.Option(
            help=f"Mass the controller believes in ({_UNITS['mass']}); the robot's.", rich_help_panel=_CONTROL
        ),
    ] = None,
    model_yaw_inertia: Annotated[
        Number,
        typer.Option(help=f"Yaw inertia it believes in ({_UNITS['yaw_inertia']}).", rich_help_panel=_CONTROL),
    ] = None,
    model_com: Annotated[
        Text,
        typer.Option(help=f"Centre of mass X,Y it believes in ({_UNITS['com']}).", rich_help_panel=_CONTROL),
    ] = None,
    robot: Annotated[
        Text, typer.Option(help="lecture (Icz = 0.1) or box (homogeneous); lecture.", rich_help_panel=_ROBOT)
    ] = None,
    urdf: Annotated[
        Path | None, typer.Option(help="The chain, or a bare base, instead.", rich_help_panel=_ROBOT)
    ] = None,
    ground: Annotated[Number, typer.Option(help=f"Beside --urdf: {_GROUND}.", rich_help_panel=_ROBOT)] = None,
    mass: Annotated[
        Number, typer.Option(help=f"Mass in its place ({_UNITS['mass']}).", rich_help_panel=_ROBOT)
    ] = None,
    yaw_inertia: Annotated[
        Number,
        typer.Option(help=f"Yaw inertia in its place ({_UNITS['yaw_inertia']}).", rich_help_panel=_ROBOT),
    ] = None,
    com: Annotated[
        Text, typer.Option(help=f"Centre of mass X,Y ({_UNITS['com']}).", rich_help_panel=_ROBOT)
    ] = None,
    dt: Annotated[float, typer.Option(help="Sampling time (s).", rich_help_panel=_LOOP)] = 0.1,
    integrator: Annotated[
        str, typer.Option(help=f"One of {', '.join(choices.INTEGRATORS)}.", rich_help_panel=_LOOP)
    ] = "constant-acceleration",
    substeps: Annotated[int, typer.Option(help="Steps of the plant per dt.", rich_help_panel=_LOOP)] = 1,
    out: Annotated[Path, typer.Option(help="Folder for records and figures.", rich_help_panel=_LOOP)] = Path(
        "out/run"
    ),
    gif: Annotated[bool, typer.Option(help="Also draw the moving robot.", rich_help_panel=_LOOP)] = False,
    html: Annotated[
        bool, typer.Option("--html", help="Also write a page that shows it move.", rich_help_panel=_LOOP)
    ] = False,
) -> int:
    """Run one closed loop: a trajectory, a controller, a robot. Without options, the lecture's circle.

    Example: what does computed torque do when the controller believes in a centre of mass that is not there?

    pinmobile run --com 0.1,0.05 --model-com 0,0 --yaw-inertia 1.3 --dt 0.01
    """
    options = locals().copy()
    folder = output_folder(out)
    return show_run(choices.closed_loop(**options), folder, controller, gif=gif, html=html)


@app.command()
def mount(
    arm: Annotated[
        list[str] | None, typer.Argument(help="Names of example-robot-data: one, or more.")
    ] = None,
    listed: Annotated[
        bool, typer.Option("--list", help="Print the names, and those that do not mount, with the reason.")
    ] = False,
    urdf: Annotated[Path | None, typer.Option(help="An arm of your own instead.")] = None,
    package_dir: Annotated[
        list[Path] | None, typer.Option(help="Folder that package:// in it refers to; repeat it.")
    ] = None,
    at: Annotated[
        list[str] | None,
        typer.Option(
            help="Its place X,Y,Z,YAW on the body (m, rad), once for each arm; the middle of the top, or one "
            "behind the other."
        ),
    ] = None,
    lock: Annotated[
        list[str] | None, typer.Option(help="Joint of the arm that shall not move; repeat it.")
    ] = None,
    dt: Annotated[float, typer.Option(help="Sampling time (s).")] = 0.001,
    duration: Annotated[float, typer.Option(help="Of the motion (s).")] = 6.0,
    html: Annotated[
        Path | None, typer.Option(help="File: a page that shows it move, the decoupled one as a ghost.")
    ] = None,
    out: Annotated[Path | None, typer.Option(help="Folder for records and figures.")] = None,
) -> int:
    """Put an arm on the base, drive a circle while it moves, and say what the coupling costs.

    Computed torque of the whole beside a controller that ignores the coupling between base and arm: errors,
    tip-over margin, and the friction that the ground must offer.

    Example: pinmobile mount ur5 --html out/ur5.html
    """
    if listed:
        if arm:
            raise InvalidArgument(f"--list stands alone, but there is {arm[0]!r} too")
        several = {"at": at or None, "lock": lock or None, "package_dir": package_dir or None}
        choices.refuse_beside("--list", urdf=urdf, html=html, out=out, **several)
        return list_mountable()
    robot = mounted(arm or (), urdf, at or (), package_dir or (), lock or ())
    return show_mount(robot, dt=dt, duration=duration, html=html, out=out)


@app.command(context_settings={"allow_extra_args": True, "ignore_unknown_options": True})
def view(
    context: typer.Context,
    rollout: Annotated[
        list[Path] | None,
        typer.Option(help="File that `run` or Rollout.save wrote; repeat it for a ghost beside it."),
    ] = None,
    host: Annotated[str, typer.Option(help="Address to serve at.")] = "127.0.0.1",
    port: Annotated[int | None, typer.Option(help="Port; by default one that is free.")] = None,
    speed: Annotated[float, typer.Option(help="Seconds of the run per second.")] = 4.0,
    follow: Annotated[bool, typer.Option(help="Let the camera follow the robot.")] = False,
    frames: Annotated[bool, typer.Option(help="Draw the frames of both DH tables.")] = False,
    arrows: Annotated[bool, typer.Option(help="Draw force and moment.")] = False,
) -> int:
    """Serve a page that shows a run again and again, also on a machine without a screen, until Ctrl-C.

    Without options it shows the lecture's circle, PD and computed torque together. It takes the options of
    [bold]pinmobile run[/bold] too, and then shows that run.

    Example: pinmobile view --trajectory via-free --controller pd
    """
    rollouts = saved_runs(rollout, context.args) if rollout else chosen_runs(context.args, app)
    overlays = overlays_of(follow=follow, frames=frames, arrows=arrows)
    return show_live(rollouts, overlays, host=host, port=port, speed=speed)
