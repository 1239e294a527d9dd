"""Verbs of the command. Each verb imports its modules, so that help needs no library."""

from pathlib import Path
from typing import Annotated, Any

import typer
import typer.core

from pinmobile import __version__

# The verbs by task, each with its page of the documentation.
TASKS = {
    "Learn": {
        "lecture": "tutorials/index",
        "exercises": "tutorials/exercises",
        "derive": "reference/derivation",
        "verify": "reference/derivation",
    },
    "Describe a robot and its loop": {
        "write": "howto/scenario-files",
        "parts": "howto/scenario-files",
        "identify": "howto/identify",
    },
    "Run it": {
        "run": "howto/scenario-files",
        "ensemble": "howto/ensembles",
        "sweep": "howto/sweeps",
        "view": "howto/view",
        "play": "howto/play",
    },
    "Put it on a robot": {"export": "howto/hardware"},
}


class Verbs(typer.core.TyperGroup):
    """The verbs of the command, listed by task."""

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write the list of verbs into the help."""
        for task, pages in TASKS.items():
            with formatter.section(task):
                formatter.write_dl([(verb, self.commands[verb].get_short_help_str(60)) for verb in pages])


app = typer.Typer(
    cls=Verbs,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    help="Dynamics and control of ground robots on Pinocchio. Type first: pinmobile lecture, pinmobile run "
    "ur5, or pinmobile write > mine.toml, a file to change and run.",
    epilog="Exit codes: 0 done; 1 a check failed, a run diverged, or the system failed; 2 invalid arguments "
    "or files; 130 interrupted.",
)


def complete(incomplete: str) -> list[str]:
    """Return the completions of a word: paths, and after = names of parts."""
    import pinmobile.cli.scenario_file as scenarios
    from pinmobile.parts import Child, names_of, parameters

    path, equals, start = incomplete.partition("=")
    *parents, last = path.split(".")
    part: Any = scenarios.LoadedFile([]).content
    for key in parents:
        part = vars(part).get(key) if part is not None else None
    kind: Any = type(part)
    fields = parameters(kind) if part is not None else {}
    declared = fields[last].declared if last in fields else None
    if equals:
        names = names_of(declared.kind) if isinstance(declared, Child) else ()
        return [f"{path}={name}" for name in names if name.startswith(start)]
    prefix = path.removesuffix(last)
    shipped = [] if parents else [name for name in scenarios.shipped_names() if name.startswith(last)]
    matches = [(name, each.declared) for name, each in fields.items() if name.startswith(last)]
    ends = [(name, end) for name, each in matches for end in ("=", ".")[: 1 + isinstance(each, Child)]]
    return [*shipped, *(f"{prefix}{name}{end}" for name, end in ends)]


Words = Annotated[
    list[str] | None,
    typer.Argument(
        metavar="[FILE] [PATH=VALUE]...",
        autocompletion=complete,
        show_default=False,
        help="Scenario file or shipped scenario, and changes: controller=PD, robot.com.x=0.1.",
    ),
]
Code = Annotated[
    bool, typer.Option("--allow-code", help="Run the modules that the file names (MODULE:NAME).")
]
Film = Annotated[
    Path | None, typer.Option(help="Film of the moving robot: a file .html, .gif, .mp4 or .png.")
]


def _folder(default: str, content: str = "records and figures") -> Any:
    return typer.Option(help=f"Folder of {content}; default: {default}.", show_default=False)


def _print_version(is_given: bool) -> None:
    if is_given:
        typer.echo(f"pinmobile {__version__}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", help="Print the version.", callback=_print_version, is_eager=True)
    ] = False,
) -> None:
    pass


@app.command()
def run(
    words: Words = None,
    out: Annotated[Path, _folder("out/run")] = Path("out/run"),
    film: Film = None,
    allow_code: Code = False,
) -> int:
    """Run one closed loop; default: the lecture's circle.

    Spread, grid and cases of the file have no effect.

    Example: pinmobile run controller.robot.com.x=0.1 dt=0.01
    """
    from pinmobile.cli.results import show_run

    return show_run(words or [], out, film, allow_code=allow_code)


@app.command()
def ensemble(
    words: Words = None,
    out: Annotated[Path, _folder("out/ensemble")] = Path("out/ensemble"),
    allow_code: Code = False,
) -> int:
    """Run n robots that differ by [spread].

    Example: pinmobile ensemble n=1000 "spread.mass=Relative(Uniform(0.8, 1.2))" after=5
    """
    from pinmobile.cli.results import show_ensemble

    return show_ensemble(words or [], out, allow_code=allow_code)


@app.command()
def sweep(
    words: Words = None,
    out: Annotated[Path | None, _folder("out/ and the file's name")] = None,
    scheduler: Annotated[
        str | None, typer.Option(help="Dask scheduler, tcp://HOST:PORT; default: all cores here.")
    ] = None,
    allow_code: Code = False,
) -> int:
    """Run an ensemble at each point of [grid] and [cases].

    A Zarr store keeps the results.

    After an interruption, repeat the command: it resumes.

    Example: pinmobile sweep rivals
    """
    from pinmobile.cli.results import show_sweep

    return show_sweep(words or [], out, scheduler, allow_code=allow_code)


@app.command()
def view(
    words: Words = None,
    host: Annotated[str, typer.Option(help="Address to serve at.")] = "127.0.0.1",
    port: Annotated[int | None, typer.Option(help="Port; default: a free one.")] = None,
    allow_code: Code = False,
) -> int:
    """Serve a page that repeats a run, or saved rollouts.

    It ends with Ctrl-C.

    Example: pinmobile view out/run/rollout.npz
    """
    from pinmobile.cli.results import show_live

    return show_live(words or [], host=host, port=port, allow_code=allow_code)


@app.command()
def play(
    words: Words = None,
    slider: Annotated[
        list[str] | None,
        typer.Option(metavar="PATH", help="Number with a slider, such as controller.kp; repeatable."),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="File for the run at its end, .npz.", show_default=False)
    ] = None,
    host: Annotated[str, typer.Option(help="Address to serve at.")] = "127.0.0.1",
    port: Annotated[int | None, typer.Option(help="Port; default: a free one.")] = None,
    allow_code: Code = False,
) -> int:
    """Run in real time on a page: sliders, keys, live plots.

    Keys drive a robot on wheels, or push a body. It ends with Ctrl-C.

    Example: pinmobile play differential --slider controller.k --slider mass
    """
    from pinmobile.cli.results import show_play

    return show_play(words or [], slider or [], out, host=host, port=port, allow_code=allow_code)


@app.command()
def export(
    words: Words = None,
    out: Annotated[Path, _folder("out/export", "the C files")] = Path("out/export"),
    name: Annotated[str, typer.Option(help="Prefix of all names and files.")] = "robot",
    precision: Annotated[str, typer.Option(help="double, or single.")] = "double",
    tunable: Annotated[
        list[str] | None,
        typer.Option(metavar="PATH", help="Number that stays a parameter, such as kp; repeatable."),
    ] = None,
    plant: Annotated[
        bool, typer.Option("--plant", help="Export the plant in place of its controller.")
    ] = False,
    allow_code: Code = False,
) -> int:
    """Write a controller as C for the robot's own processor.

    The trajectory becomes a table. A test program with recorded samples comes with the code.

    Example: pinmobile export differential --tunable controller.k
    """
    from pinmobile.cli.results import show_export

    return show_export(
        words or [], out, tunable or [], name=name, precision=precision, plant=plant, allow_code=allow_code
    )


@app.command()
def write(words: Words = None, allow_code: Code = False) -> int:
    """Print a scenario as a file, with units and bounds.

    Example: pinmobile write mecanum controller.kp=9 > mine.toml
    """
    from pinmobile.cli.scenario_file import LoadedFile

    typer.echo(LoadedFile(words or [], allow_code=allow_code).to_toml(), nl=False)
    return 0


@app.command()
def parts(
    name: Annotated[str | None, typer.Argument(help="Part, such as PD.", show_default=False)] = None,
    schema: Annotated[
        bool, typer.Option("--schema", help="Print the JSON schema of scenario files, for editors.")
    ] = False,
) -> int:
    """List the parts of a scenario, or the fields of one.

    Example: pinmobile parts WheelTable.differential
    """
    from pinmobile.cli import scenario_file

    if schema:
        import json

        from pinmobile.parts import schema_of

        typer.echo(json.dumps(schema_of(scenario_file.ScenarioFile), indent=1))
    else:
        typer.echo(scenario_file.describe_part(name) if name else scenario_file.list_parts())
    return 0


@app.command()
def identify(
    words: Annotated[
        list[str],
        typer.Argument(
            metavar="LOG... [PATH=VALUE]...",
            help="Logs of one robot (CSV, bag or MCAP files), and options PATH=VALUE.",
        ),
    ],
    out: Annotated[Path, _folder("out/identify")] = Path("out/identify"),
) -> int:
    """Estimate mass, inertia and friction from robot logs.

    Confidence intervals belong to the estimates.

    Inputs are forces on a body, or with robot=... torques or volts of its wheels. Two inputs without a robot
    are commands of speed and yaw rate, or of a car: speed [m/s] and steering angle [rad]. Paths: robot,
    by, loads, method, delay, rolling_speed, wheelbase, columns.ROLE, topics.ROLE. The roles are t, q, u,
    twist, wheel_rates and joints. With by=NAME,NAME, any numbers of the robot are estimated, such as
    *_link.mass.

    Example: pinmobile identify run.csv columns.q=px,py,yaw "robot=WheelTable.differential(0.5, 0.1)"
    """
    from pinmobile.cli.results import show_identification

    return show_identification(words, out)


@app.command()
def verify(
    words: Words = None,
    states: Annotated[int, typer.Option(help="Number of random states.")] = 200,
    allow_code: Code = False,
) -> int:
    """Compare all methods for the dynamics of a robot.

    Closed form, Pinocchio, symbolic derivation and machine code.

    Example: pinmobile verify ur5
    """
    from pinmobile.cli.lecture import show_verification

    return show_verification(words or [], states, allow_code=allow_code)


@app.command()
def derive(
    words: Words = None,
    latex: Annotated[bool, typer.Option("--latex", help="Print LaTeX instead of text.")] = False,
    allow_code: Code = False,
) -> int:
    """Derive the equations of motion, step by step.

    They follow from the DH table of a robot, or from its rolling wheels.

    Example: pinmobile derive car
    """
    from pinmobile.cli.lecture import show_derivation

    return show_derivation(words or [], latex=latex, allow_code=allow_code)


@app.command()
def lecture(
    out: Annotated[Path, _folder("out")] = Path("out"),
    gif: Annotated[bool, typer.Option(help="Also draw the moving robot.")] = True,
    mp4: Annotated[bool, typer.Option("--mp4", help="Also make a film (needs Chromium, extra mp4).")] = False,
) -> int:
    """Derive, verify, run and draw the whole lecture.

    Example: pinmobile lecture --no-gif
    """
    from pinmobile.cli.lecture import show_lecture

    return show_lecture(out, gif=gif, mp4=mp4)


exercises = typer.Typer(
    rich_markup_mode=None,
    help="List, start and check exercises.",
    epilog="Example: pinmobile exercises start; pinmobile exercises check exercises/01_equations.ipynb",
)
app.add_typer(exercises, name="exercises")


@exercises.command("list")
def list_exercises() -> int:
    """List the exercises with their points."""
    from pinmobile.exercises import list_exercises

    typer.echo(list_exercises())
    return 0


@exercises.command()
def start(
    folder: Annotated[Path, typer.Argument(help="Folder for the notebooks.")] = Path("exercises"),
    seed: Annotated[
        str, typer.Option(metavar="COURSE", help="Course, for which the numbers are drawn.")
    ] = "",
) -> int:
    """Write the notebooks for students; files that exist stay as they are.

    Example: pinmobile exercises start --seed ROB-2026
    """
    from pinmobile.exercises import start_exercises

    typer.echo("\n".join(start_exercises(folder, seed=seed)))
    typer.echo(f"next: jupyter lab {folder}, then: pinmobile exercises check {folder}/01_equations.ipynb")
    return 0


@exercises.command()
def check(
    files: Annotated[list[Path], typer.Argument(metavar="FILE...", help="Notebooks, .ipynb or .py.")],
    seed: Annotated[
        str | None,
        typer.Option(metavar="COURSE", help="Course that the notebooks must have.", show_default=False),
    ] = None,
    limit: Annotated[float, typer.Option(metavar="SECONDS", help="Longest time for a notebook (s).")] = 60.0,
) -> int:
    """Run notebooks and print the points of each; the exit code is 0 if all are complete.

    Example: pinmobile exercises check exercises/*.ipynb
    """
    from pinmobile.exercises import check_exercises

    code = 0
    for report in check_exercises(files, seed=seed, limit=limit):
        typer.echo(report, err=not report.verdicts)
        code = max(code, 0 if report.is_complete else 1 if report.verdicts else 2)
    return code
