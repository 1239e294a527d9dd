"""The commands that run many loops, beside the others, and their options."""

from pathlib import Path
from typing import Annotated

import typer
from rich.markup import escape

from pinmobile.cli.commands import app
from pinmobile.cli.many import run_options, show_ensemble, show_sweep
from pinmobile.cli.output import output_folder
from pinmobile.cli.scenario_file import EXAMPLE
from pinmobile.cli.spreads import SPREAD_FORMS, listed

__all__ = ["app"]

Text = str | None


@app.command(
    context_settings={"allow_extra_args": True, "ignore_unknown_options": True},
    epilog=f"What may be spread (unit):\n\n{listed()}",
)
def ensemble(
    context: typer.Context,
    n: Annotated[int, typer.Option("--n", help="Number of robots.")] = 10_000,
    seed: Annotated[int, typer.Option(help="Seed of what is drawn.")] = 0,
    spread: Annotated[
        list[str] | None,
        typer.Option(help=f"NAME=FORM, what differs; the form is {SPREAD_FORMS}. Repeat it for more."),
    ] = None,
    after: Annotated[
        float, typer.Option(help="Time [s] when the start is over: errors count from then on.")
    ] = 0.0,
    out: Annotated[Path, typer.Option(help="Folder for figures and their index page.")] = Path(
        "out/ensemble"
    ),
) -> int:
    """Run one closed loop many times, each time with another robot, start or disturbance.

    It compares PD and computed torque, or runs the one that --controller names. It takes the options of
    [bold]pinmobile run[/bold] too.

    Example: pinmobile ensemble --spread mass=percent:20 --spread start_x=normal:0,0.02 --after 5
    """
    options, one = run_options(context.args, app, "ensemble")
    folder = output_folder(out)
    return show_ensemble(options, spread or [], folder, n=n, seed=seed, after=after, one=one)


@app.command(
    epilog=f"A scenario file, which runs as it is:\n\n{escape(EXAMPLE)}\n\nWhat may be spread (unit):\n\n"
    + listed()
)
def sweep(
    file: Annotated[Path, typer.Argument(help="Scenario file (TOML).")],
    out: Annotated[
        Path | None, typer.Option(help="Folder for the store and figures; out/ and the file's name.")
    ] = None,
    scheduler: Annotated[
        str | None,
        typer.Option(help="Dask scheduler to compute on, tcp://HOST:PORT; otherwise all cores here."),
    ] = None,
    chunk: Annotated[int | None, typer.Option(help="Robots in a chunk; 16384.")] = None,
    allow_code: Annotated[
        bool,
        typer.Option(
            "--allow-code",
            help="Run the modules whose parts the file names (MODULE:NAME), here and on the workers.",
        ),
    ] = False,
) -> int:
    """Run the ensembles of a scenario file along the axes of its grid, and keep them in a Zarr store.

    Interrupted, it goes on where it was when it is started again.

    A type may name a part of yours, "module:Name", of a module beside the file; the other keys of its table
    are the arguments of the class. Code is run with --allow-code alone.
    """
    return show_sweep(file, out, scheduler, chunk, allow_code=allow_code)
