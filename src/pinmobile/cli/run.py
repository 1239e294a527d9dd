"""One closed loop: run it, record it, draw it, say what came of it."""

from pathlib import Path
from typing import Any

from pinmobile import Diverged, MobileRobot, Rollout, plots, simulate
from pinmobile.cli.output import Picture, Section, begin, console, index_page, progress, save_figure
from pinmobile.cli.view import save_page

__all__ = ["FIGURES", "draw", "show_run"]

_PLANE = 3  # coordinates of a bare base

FIGURES = {
    "path": "The desired path (dashed), the travelled one, and the robot where it really was.",
    "states": "{} over time, desired and actual.",
    "errors": "Desired minus actual {} over time, angles on the circle.",
    "forces": "The generalised force, held between samples.",
}


def draw(rollouts: dict[str, Rollout], folder: Path, prefix: str, bar: Any) -> list[Picture]:
    """Write the four figures of some rollouts, one step of the progress bar each.

    Parameters
    ----------
    rollouts : dict of str to Rollout
        What is drawn side by side.
    folder : Path
        Where to.
    prefix : str
        Beginning of the files' names.
    bar : rich.progress.Progress
        Its first task is advanced.
    """
    arms = any(len(run.labels) > _PLANE for run in rollouts.values())
    drawn = "x, y, psi and each joint" if arms else "x, y and psi"
    pictures = []
    for name, caption in FIGURES.items():
        begin(bar, f"drawing {prefix}{name}")
        save_figure(getattr(plots, name)(rollouts), folder / f"{prefix}{name}.png")
        pictures.append(Picture(f"{prefix}{name}.png", caption.format(drawn)))
    return pictures


def show_run(
    loop: tuple[MobileRobot, Any, Any, dict[str, Any]], folder: Path, label: str, *, gif: bool, html: bool
) -> int:
    """Run, print the judgement, and write records, figures and their index; a diverged run too."""
    plant, law, trajectory, options = loop
    with progress(len(FIGURES) + 2 + gif + html) as bar:
        begin(bar, "simulating")
        diverged: Diverged | None = None
        try:
            rollout = simulate(plant, law, trajectory, **options)
        except Diverged as error:
            if error.rollout is None:
                raise
            diverged, rollout = error, error.rollout
        begin(bar, "recording")
        rollout.save(folder / "rollout.npz")
        rollout.to_csv(folder / "rollout.csv")
        pictures = draw({label: rollout}, folder, "", bar)
        if gif:
            begin(bar, "drawing the moving robot")
            plots.animate(rollout, folder / "animation.gif")
            pictures.insert(0, Picture("animation.gif", "The robot as it moves."))
        pages = []
        if html:
            begin(bar, "recording the scene")
            save_page({label: rollout}, folder / "scene.html", f"{label} on {plant}")
            pages.append(Picture("scene.html", "See it move."))
    console.print(f"robot: {plant}, {plant.source}", markup=False)
    if diverged is not None:
        console.print("up to there:", markup=False)
    console.print(str(rollout), markup=False)
    text = str(rollout) if diverged is None else f"{diverged}\n\nup to there:\n{rollout}"
    page = index_page(folder, f"{label} on {plant}", [Section("What came of it", text, pictures, pages)])
    console.print(
        f"wrote {folder / 'rollout.npz'} (Rollout.load reads it), rollout.csv and figures\nopen {page}",
        markup=False,
    )
    if html:
        console.print(f"see it move: open {folder / 'scene.html'}", markup=False)
    if diverged is not None:
        raise diverged
    return 0
