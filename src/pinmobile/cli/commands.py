"""The commands and their options; each imports what it runs, since that takes a while."""

import inspect
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Annotated, Any, TypeVar

import typer
from rich.markup import escape

import pinmobile
from pinmobile.cli.choices import (
    DEFAULT_PRESET,
    DRIVES,
    GROUND,
    OF_DRIVES,
    OF_ENSEMBLES,
    OF_LOOPS,
    OF_ROLLING,
    OF_SPEEDS,
    OPTIONS,
    ROLLING,
    SPREAD_FORMS,
    TABLES,
    Numbers,
    Option,
    body,
)
from pinmobile.cli.options import Options, as_option, body_of, choose, plant_of, spreadable
from pinmobile.cli.output import console, output_folder, progress
from pinmobile.cli.scenario_file import EXAMPLE
from pinmobile.errors import InvalidArgument
from pinmobile.identification import VELOCITY_ROBOTS
from pinmobile.wheels import MOTORS

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode="rich",
    pretty_exceptions_enable=False,
    help="Dynamics and control of ground robots on Pinocchio. Start with [bold]pinmobile lecture[/bold].",
    epilog="Exit codes: 0 done; 1 done, and the answer is no, or the system failed, as of a full disk; "
    "2 options or files are wrong; 130 interrupted.",
)

_Command = TypeVar("_Command", bound=Callable[..., int])
_LOOP, _DRIVE = "Loop and output", "Drive"
_PANELS = {
    "drive": "Drive",
    "robot": "Robot",
    "trajectory": "Trajectory",
    "controller": "Controller",
    "loop": _LOOP,
}
_VERIFIED: dict[str, Numbers] = {"mass": 10.0, "yaw_inertia": 1.2, "com": (0.15, 0.05)}
_TAKES_RUNS = {"allow_extra_args": True, "ignore_unknown_options": True}


def _taking(options: Iterable[Option], *, panels: bool = False) -> Callable[[_Command], _Command]:
    """Put options before those that a command states itself; it takes them by their names, as ``**typed``."""

    def with_options(command: _Command) -> _Command:
        own = inspect.signature(command)
        stated = [each for each in own.parameters.values() if each.kind is not each.VAR_KEYWORD]
        last = [each.replace(kind=each.KEYWORD_ONLY) for each in stated if each.name != "context"]
        first = [each for each in stated if each.name == "context"]
        parameters = [*first, *(_parameter(each, _PANELS if panels else {}) for each in options), *last]
        command.__signature__ = own.replace(parameters=parameters)  # type: ignore[attr-defined]
        return command

    return with_options


def _parameter(option: Option, panels: Mapping[str, str]) -> inspect.Parameter:
    kind = str if option.kind is tuple else option.kind
    shown = typer.Option(as_option(option.name), help=option.text, rich_help_panel=panels.get(option.table))
    return inspect.Parameter(
        option.name,
        inspect.Parameter.KEYWORD_ONLY,
        default=option.default,
        annotation=Annotated[kind if option.default is not None else kind | None, shown],
    )


def _commands() -> dict[str, Any]:
    """Return the commands as typer makes them, by name."""
    group: Any = typer.main.get_command(app)
    return dict(group.commands)


def as_typed(error: InvalidArgument) -> InvalidArgument:
    """Return an error of the library; where its argument is an option, that is called as it was typed."""
    options = {
        option.name
        for each in _commands().values()
        for option in each.params
        if option.opts[0].startswith("--")
    }
    return error.calling(as_option(error.argument)) if error.argument in options else error


def _of_run(words: Sequence[str], name: str, why: str) -> tuple[Options, bool]:
    """Return the options of `run` in the words of another command, and whether a controller is among them.

    Parameters
    ----------
    words : sequence of str
        What the command itself does not take.
    name, why : str
        Of the command, and why it takes none of the options that write files.

    Raises
    ------
    InvalidArgument
        If one of those is among them.
    """
    run = _commands()["run"]
    own = [each for each in run.params if each.name not in OPTIONS]
    writing = {word for each in own for word in (*each.opts, *each.secondary_opts)}
    for word in words:
        if word.split("=")[0] in writing:
            raise InvalidArgument(f"{word} does not apply to {name}, which {why}")
    context = run.make_context(name, list(words))
    given = context.get_parameter_source("controller")
    return Options(context.params), given is not None and given.name == "COMMANDLINE"


def _help(text: str, *names: str, panel: str | None = None) -> Any:
    return typer.Option(*names, help=text, rich_help_panel=panel)


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


_FILM = "Also film the moving robot in its scene: needs Chromium and the extra mp4."


@app.command()
def lecture(
    out: Annotated[Path, _help("Folder for the figures and their index page.")] = Path("out"),
    gif: Annotated[bool, _help("Also draw the moving robot.")] = True,
    mp4: Annotated[bool, _help(_FILM)] = False,
) -> int:
    """Work through the whole lecture: derive, verify, run, and draw.

    It derives M(q) and n(q, v) from the Denavit-Hartenberg table, compares five routes to them, runs
    {via stop, via free, circle} x {PD, computed torque} with the lecture's numbers, prints the largest
    errors beside the lecture's, and writes every figure with an index page.
    """
    from pinmobile.cli.run import show_lecture

    return show_lecture(output_folder(out), gif=gif, mp4=mp4)


@app.command()
@_taking((GROUND, *body(numbers=_VERIFIED)))
def verify(
    urdf: Annotated[Path | None, _help("Verify the robot of this URDF: the chain, or a bare base.")] = None,
    table: Annotated[str | None, _help("DH table: lecture or slide; lecture.")] = None,
    mount: Annotated[list[str] | None, _help("Arm to mount, as in `pinmobile mount`; repeatable.")] = None,
    drive: Annotated[str | None, _help(f"Verify the box on wheels: {', '.join(DRIVES)}.")] = None,
    states: Annotated[int, _help("Number of random states.")] = 200,
    seed: Annotated[int, _help("Seed of the states.")] = 0,
    **typed: object,
) -> int:
    """Compare closed form, Pinocchio, symbolic Newton-Euler, Lagrange and machine code: M, n, tau, a.

    With an arm on it (--mount ur5), Pinocchio's algorithms against each other, against Newton's and Euler's
    laws for its parts and against machine code, and the base against the closed form.
    """
    options = Options({**typed, "urdf": urdf, "table": table})
    if urdf is None:
        options.refuse(["ground"], "applies beside --urdf alone")
    robot: Any
    if drive is not None:
        from pinmobile.cli.drive import wheeled_of

        options.refuse(["urdf", *_VERIFIED, "table"], "does not apply beside --drive")
        robot = wheeled_of({}, drive, arms=mount or ())
    elif mount:
        from pinmobile.cli.mount import mounted

        options.refuse(["urdf", *_VERIFIED, "table"], "does not apply beside --mount")
        robot = mounted(mount)
    elif urdf is not None:
        options.refuse([*_VERIFIED, "table"], "does not apply beside --urdf")
        robot = plant_of(options)
    else:
        dh = choose("table", table or "lecture", TABLES)
        robot = pinmobile.MobileRobot(**{**_VERIFIED, **body_of(options)}, dh=dh)
    with progress(1, "deriving and comparing"):
        verification = pinmobile.verify(robot, states=states, seed=seed)
    told = f"a box on wheels, {drive}" if drive is not None else f"{robot.source}: {robot}"
    console.print(told, markup=False)
    console.print(str(verification), markup=False)
    console.print("every route agrees" if verification.passed else "the routes do NOT agree")
    return 0 if verification.passed else 1


@app.command()
def derive(
    table: Annotated[str | None, _help("DH table: lecture or slide; lecture.")] = None,
    drive: Annotated[
        str | None, _help("Instead, wheels that roll under the lecture's body: differential, roller or car.")
    ] = None,
    latex: Annotated[bool, _help("Print LaTeX instead of text.", "--latex")] = False,
) -> int:
    """Derive the equations of motion from the DH table, every step of the lecture's symbolic script.

    With --drive those of a robot on wheels, in independent velocities: velocities at the ground, constraint
    matrix, null space, reduced model.
    """
    if drive is not None:
        Options({"table": table}).refuse(["table"], "does not apply beside --drive")
    dh = choose("table", table or "lecture", TABLES)
    with progress(1, "deriving"):
        reduced = {
            "differential": pinmobile.derivation.differential_drive,
            "roller": pinmobile.derivation.roller_drive,
            "car": pinmobile.derivation.car,
        }
        lecture = partial(pinmobile.derivation.lecture, dh)
        derivation = (lecture if drive is None else choose("drive", drive, reduced))()
    console.print(derivation.latex() if latex else str(derivation), markup=False)
    return 0


@app.command()
@_taking(OF_LOOPS, panels=True)
def run(
    out: Annotated[Path, _help("Folder for records and figures.", panel=_LOOP)] = Path("out/run"),
    gif: Annotated[bool, _help("Also draw the moving robot.", panel=_LOOP)] = False,
    mp4: Annotated[bool, _help(_FILM, "--mp4", panel=_LOOP)] = False,
    html: Annotated[bool, _help("Also write a page that shows it move.", "--html", panel=_LOOP)] = False,
    **typed: object,
) -> int:
    """Run one closed loop: a trajectory, a controller, a robot. Without options, the lecture's circle.

    Example: what does computed torque do when the controller believes in a centre of mass that is not there?

    pinmobile run --com 0.1,0.05 --model-com 0,0 --yaw-inertia 1.3 --dt 0.01
    """
    from pinmobile.cli.run import show_run

    return show_run(Options(typed), output_folder(out), gif=gif, mp4=mp4, html=html)


@app.command()
def mount(
    arm: Annotated[
        list[str] | None, typer.Argument(help="Names of example-robot-data: one, or more.")
    ] = None,
    *,
    listed: Annotated[
        bool, _help("Print the names, and those that cannot be mounted with the reason.", "--list")
    ] = False,
    urdf: Annotated[Path | None, _help("URDF of an arm of your own, instead of a name.")] = None,
    package_dir: Annotated[list[Path] | None, _help("Folder of package:// in the URDF; repeatable.")] = None,
    at: Annotated[
        list[str] | None,
        typer.Option(
            help="Place X,Y,Z,YAW of the arm on the body (m, rad), once for each; by default the middle of "
            "the top, or one behind the other."
        ),
    ] = None,
    lock: Annotated[list[str] | None, _help("Joint of the arm to hold still; repeatable.")] = None,
    dt: Annotated[float, _help("Sampling time (s).")] = 0.001,
    duration: Annotated[float, _help("Duration of the motion (s).")] = 6.0,
    html: Annotated[
        Path | None, _help("File for a page that shows it move, decoupled control as a ghost.")
    ] = None,
    out: Annotated[Path | None, _help("Folder for records and figures.")] = None,
) -> int:
    """Put an arm on the base, drive a circle while it moves, and say what the coupling costs.

    Computed torque of the whole beside a controller that ignores the coupling between base and arm: errors,
    tip-over margin, and the friction that the ground must offer.

    Example: pinmobile mount ur5 --html out/ur5.html
    """
    from pinmobile.cli.mount import list_mountable, mounted, show_mount

    if listed:
        if arm:
            raise InvalidArgument(f"--list stands alone, but there is {arm[0]!r} too")
        several = {"at": at or None, "lock": lock or None, "package_dir": package_dir or None}
        others = Options({"urdf": urdf, "html": html, "out": out, **several})
        others.refuse([*others.values], "does not apply beside --list")
        return list_mountable()
    robot = mounted(arm or (), urdf, at or (), package_dir or (), lock or ())
    return show_mount(robot, dt=dt, duration=duration, html=html, out=out)


@app.command()
@_taking(OF_DRIVES, panels=True)
def drive(
    name: Annotated[
        str | None,
        typer.Argument(help=f"One of {', '.join(DRIVES)}; or velocity, a robot that takes speeds."),
    ] = None,
    *,
    preset: Annotated[
        str | None,
        _help(f"Of velocity: {', '.join(VELOCITY_ROBOTS)}; {DEFAULT_PRESET}.", panel=_DRIVE),
    ] = None,
    theta: Annotated[
        str | None, _help("Of velocity, in place of --preset: its six numbers, with commas.", panel=_DRIVE)
    ] = None,
    urdf: Annotated[Path | None, _help("URDF of a robot, with the wheels that it has.", panel=_DRIVE)] = None,
    package_dir: Annotated[
        list[Path] | None, _help("Folder of package:// in the URDF; repeatable.", panel=_DRIVE)
    ] = None,
    rollers: Annotated[
        str | None,
        _help(
            "Angle of the rollers of the URDF's wheels (rad), 0.785 of mecanum; none: tyres.", panel=_DRIVE
        ),
    ] = None,
    mu: Annotated[
        float | None,
        _help("Let the wheels slip, with this coefficient of friction; by default they roll.", panel=_DRIVE),
    ] = None,
    dt: Annotated[float, _help("Sampling time (s).", panel=_LOOP)] = 0.01,
    html: Annotated[
        Path | None,
        _help("File for a page that shows it move, with the forces at its wheels.", panel=_LOOP),
    ] = None,
    out: Annotated[Path | None, _help("Folder for records and figures.", panel=_LOOP)] = None,
    **typed: object,
) -> int:
    """Drive a path on wheels: their torques, loads and friction, and what of it slips.

    The drive tells the controller: computed torque where it can move in every direction, backstepping on the
    kinematic tracking law where it cannot, and wheel speeds where wheels skid or more than two are steered,
    which rolls on no ideal ground: friction is then 0.8. A robot that takes speeds for commands, velocity,
    is driven by backstepping that knows how late its firmware is.

    Example: pinmobile drive mecanum --html out/mecanum.html
    """
    from pinmobile.cli.drive import OfFile, show_drive, velocity_robot_of, wheeled_of

    speeds = {"preset": preset, "theta": theta}
    if name in OF_SPEEDS:
        wheels = {"urdf": urdf, "package_dir": package_dir or None, "rollers": rollers, "mu": mu}
        Options(wheels).refuse([*wheels], f"does not apply to {name}, which takes --preset or --theta")
        commanded = velocity_robot_of(typed, **speeds)
        return show_drive(typed, commanded, preset or str(name), dt=dt, html=html, out=out)
    Options(speeds).refuse([*speeds], "applies to velocity alone")
    if urdf is None:
        Options({"rollers": rollers}).refuse(["rollers"], "applies beside --urdf alone")
    file = None if urdf is None else OfFile(urdf, tuple(package_dir or ()), rollers)
    robot = wheeled_of(typed, name, file, mu=mu)
    return show_drive(typed, robot, name or str(urdf), dt=dt, html=html, out=out)


@app.command()
@_taking(OF_ROLLING, panels=True)
def identify(
    log: Annotated[
        list[Path],
        typer.Argument(
            help="CSV file with t, x, y, psi and Fx, Fy, Mz in its header, or of wheels u_left, u_right and "
            "rate_left, rate_right of encoders, units in brackets; a bag or MCAP file with --bag. Several "
            "are of one robot: runs, or what is on each side of a gap."
        ),
    ],
    *,
    column: Annotated[
        list[str] | None,
        _help(
            "ROLE=NAME,NAME, where columns are called otherwise; q=px,py,angle, or twist=speed,yaw_rate, "
            "say. Repeat it: t, q, u, twist, wheel_rates."
        ),
    ] = None,
    bag: Annotated[
        list[str] | None,
        _help("ROLE=TOPIC, where the file is a bag or MCAP; q=/odom and u=/wrench, say. Repeat it."),
    ] = None,
    urdf: Annotated[
        Path | None,
        _help("Robot as it is believed to be, on the wheels that it has; kept where the log tells nothing."),
    ] = None,
    rollers: Annotated[
        float | None,
        _help("Angle of the rollers of the URDF's wheels (rad), 0.785 of mecanum.", panel=_DRIVE),
    ] = None,
    drive: Annotated[
        str | None,
        _help(f"Inputs are of the wheels of a drive: {', '.join(ROLLING)}.", panel=_DRIVE),
    ] = None,
    wheel_mass: Annotated[
        float | None,
        _help("Of each wheel, a uniform disc whose turning is known (kg); 0.", panel=_DRIVE),
    ] = None,
    motor: Annotated[
        str | None,
        _help(
            "Inputs are volts, of this motor at each driven wheel: "
            f"{', '.join(MOTORS)}; or its numbers, resistance=1.2,torque_constant=0.04,voltage=24,gear=30.",
            panel=_DRIVE,
        ),
    ] = None,
    load: Annotated[
        list[str] | None,
        _help(
            "none, or a known load KG@X,Y or KG@X,Y,INERTIA (m, kg m^2), once for each LOG: loads that "
            "differ tell the scale of the input."
        ),
    ] = None,
    method: Annotated[str | None, _help("output-error, or weak, which is faster; output-error.")] = None,
    delay: Annotated[float | None, _help("By which poses come late (s); by default it is found.")] = None,
    rolling_speed: Annotated[
        float | None,
        _help("Speed at which dry friction has 71 % of its size; 0.01 (m/s), of wheels 0.1 (rad/s)."),
    ] = None,
    out: Annotated[Path, _help("Folder for the figure.")] = Path("out/identify"),
    **typed: object,
) -> int:
    """Estimate mass, centre of mass, yaw inertia and friction, with confidence intervals, from a robot log.

    Its inputs are forces on a body that is pushed, or torques or volts of wheels, with --drive or a --urdf
    that has wheels. Two inputs without these are commands of speed and yaw rate: then it tells theta of a
    robot that takes speeds. It prints the table, and draws what was measured beside what the model that was
    found foretells, of several logs that of the longest.

    A log in degrees, with gaps, of two clocks, too short, without excitation or of another robot is refused
    in one line, with exit code 2.

    Example: pinmobile identify run.csv --drive differential --track 0.5 --wheel-radius 0.1
    """
    from pinmobile.cli.identify import believed_of, loads_of, read, show_identification

    logs = [read(each, column or (), bag or ()) for each in log]
    stated = {"urdf": urdf, "rollers": rollers, "wheel_mass": wheel_mass, "motor": motor}
    robot = believed_of({**typed, **stated}, drive, logs[0].u.shape[1])
    loads = loads_of(load, len(log))
    return show_identification(
        logs, log, out, robot, loads=loads, method=method, delay=delay, rolling_speed=rolling_speed
    )


@app.command(context_settings=_TAKES_RUNS)
def view(
    context: typer.Context,
    rollout: Annotated[
        list[Path] | None,
        _help("File written by `run` or Rollout.save; further ones are ghosts."),
    ] = None,
    *,
    host: Annotated[str, _help("Address to serve at.")] = "127.0.0.1",
    port: Annotated[int | None, _help("Port; by default a free one.")] = None,
    speed: Annotated[float, _help("Seconds of the run per second.")] = 4.0,
    follow: Annotated[bool, _help("Let the camera follow the robot.")] = False,
    frames: Annotated[bool, _help("Draw the frames of both DH tables.")] = False,
    arrows: Annotated[bool, _help("Draw force and moment.")] = False,
) -> int:
    """Serve a page that shows a run again and again, also on a machine without a screen, until Ctrl-C.

    Without options it shows the lecture's circle, PD and computed torque together. It takes the options of
    [bold]pinmobile run[/bold] too, and then shows that run.

    Example: pinmobile view --trajectory via-free --controller pd
    """
    from pinmobile.cli.run import chosen_runs, overlays_of, saved_runs, show_live

    words = context.args
    if rollout:
        rollouts = saved_runs(rollout, words)
    else:
        rollouts = chosen_runs(_of_run(words, "view", "writes no files")[0] if words else None)
    overlays = overlays_of(follow=follow, frames=frames, arrows=arrows)
    return show_live(rollouts, overlays, host=host, port=port, speed=speed)


@app.command(context_settings=_TAKES_RUNS, epilog=f"What may be spread (unit):\n\n{spreadable()}")
@_taking(OF_ENSEMBLES)
def ensemble(
    context: typer.Context,
    spread: Annotated[
        list[str] | None, _help(f"NAME=FORM, what differs; FORM is {SPREAD_FORMS}. Repeat it for more.")
    ] = None,
    out: Annotated[Path, _help("Folder for figures and their index page.")] = Path("out/ensemble"),
    **drawn: Any,
) -> int:
    """Run one closed loop many times, each time with another robot, start or disturbance.

    It compares PD and computed torque, or runs the one that --controller names. It takes the options of
    [bold]pinmobile run[/bold] too.

    Example: pinmobile ensemble --spread mass=percent:20 --spread start.x=normal:0,0.02 --after 5
    """
    from pinmobile.cli.ensembles_and_sweeps import show_ensemble

    options, one = _of_run(context.args, "ensemble", "draws no single robot")
    return show_ensemble(options, spread or [], output_folder(out), one=one, **drawn)


@app.command(
    epilog=f"A scenario file, which runs as it is:\n\n{escape(EXAMPLE)}\n\nWhat may be spread (unit):\n\n"
    + spreadable()
)
def sweep(
    file: Annotated[Path, typer.Argument(help="Scenario file (TOML).")],
    out: Annotated[Path | None, _help("Folder for the store and figures; out/ and the file's name.")] = None,
    scheduler: Annotated[
        str | None, _help("Dask scheduler to compute on, tcp://HOST:PORT; otherwise all cores here.")
    ] = None,
    chunk: Annotated[int | None, _help("Robots in a chunk; 16384.")] = None,
    allow_code: Annotated[
        bool,
        _help(
            "Run the modules whose parts the file names (MODULE:NAME), here and on the workers.",
            "--allow-code",
        ),
    ] = False,
    version_word: Annotated[
        str | None,
        _help("A word to change whenever your own parts change in a way that the store cannot recognise."),
    ] = None,
) -> int:
    """Run the ensembles of a scenario file along the axes of its grid, and keep them in a Zarr store.

    Interrupted, it goes on where it was when started again.

    A type may name a part of yours, "module:Name", of a module beside the file; the other keys of its table
    are the arguments of the class. Code is run with --allow-code alone.
    """
    from pinmobile.cli.ensembles_and_sweeps import show_sweep

    return show_sweep(file, out, scheduler, chunk, allow_code=allow_code, version=version_word)
