"""A box with arms on it, a motion that couples base and arms, what the coupling costs and the base feels."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.progress import Progress

from pinmobile import (
    Circle,
    ComputedTorque,
    CubicVia,
    Decoupled,
    Diverged,
    InvalidArgument,
    MobileRobot,
    Rollout,
    Tangent,
    WholeBody,
    mountable,
    plots,
    required_friction,
    rk4,
    simulate,
    tip_over_margin,
)
from pinmobile.arrays import Array, positive
from pinmobile.cli.options import LECTURE, numbers
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
from pinmobile.cli.run import FIGURES, draw, save_page
from pinmobile.controllers import Controller
from pinmobile.measures import in_words

_RADIUS, _RATE = 1.0, 0.5  # of the circle [m], [rad/s]
_WAY = {"rad": 0.5, "m": 0.1}  # that each joint goes and comes back
_GAINS = 100.0, 20.0
_HEAVY = 6e6  # bytes of a page that is no longer light

_BALANCE = {
    "balance": "Tip-over margin, friction that the ground must offer, and the zero-moment point.",
    "reaction": "Force and moment of the arm on the base, at its mount.",
}


def mounted(
    arms: Sequence[str],
    urdf: Path | None = None,
    at: Sequence[str] = (),
    dirs: Sequence[Path] = (),
    locked: Sequence[str] = (),
) -> MobileRobot:
    """Return the box of 30 kg with the arms on it.

    Parameters
    ----------
    arms : sequence of str
        Names, mounted one after the other.
    urdf : Path, optional
        A file with an arm, in place of names.
    at : sequence of str
        ``X,Y,Z,YAW`` of each arm [m, m, m, rad], or none at all.
    dirs : sequence of Path
        Where the file's ``package://`` is.
    locked : sequence of str
        Joints of the only arm that shall not move.

    Raises
    ------
    InvalidArgument, UnknownName
        If there is no arm, or an option is not what is expected.
    """
    if urdf is not None and arms:
        raise InvalidArgument(f"--urdf stands for an arm, but there is {arms[0]!r} too")
    if dirs and urdf is None:
        raise InvalidArgument("--package-dir applies beside --urdf alone")
    wanted: list[str | Path] = [urdf] if urdf is not None else list(arms)
    if not wanted:
        raise InvalidArgument(
            "mount needs an arm: 'pinmobile mount ur5 --html out/ur5.html', or a file by --urdf; "
            "'pinmobile mount --list' prints the names",
            argument="",
        )
    if at and len(at) != len(wanted):
        raise InvalidArgument(
            f"--at is given {len(at)} times for {len(wanted)} arms, expected once for each arm"
        )
    if locked and len(wanted) > 1:
        raise InvalidArgument(f"--lock applies to one arm, but there are {len(wanted)}")
    box = MobileRobot.box()
    with LECTURE.naming("urdf", **({} if urdf is None else {"arm": "urdf"})):
        ready = [box.mount(arm, package_dirs=dirs, locked=locked).mounts[0] for arm in wanted]
    length = box.size[0] if len(wanted) > 1 else 0.0
    places = [
        (x, *mount.at[1:])
        for x, mount in zip(np.linspace(length, -length, len(ready)) / 3, ready, strict=True)
    ]
    for mount, place in zip(ready, [numbers("--at", text) for text in at] or places, strict=True):
        box = box.mount(mount.arm, place)
    return box


def demonstration(robot: MobileRobot, duration: float) -> WholeBody:
    """Return the circle, beside it every joint 0.5 rad (0.1 m) away and back, or as far as it can in time."""
    rest = robot.rest
    units = np.array([one.unit for one in robot.coordinates])
    way = np.select([units == unit for unit in _WAY], list(_WAY.values()))
    # A cubic from rest to rest is at most 3/2 as fast as on average; it has half the time.
    way = np.minimum(way, robot.velocity_limit * (duration / 2) / 1.5)
    up, down = (np.minimum(room, way) for room in (robot.upper - rest, rest - robot.lower))
    upwards = np.where(np.isclose(up, down), _lifts(robot, way), up > down)
    target = rest + np.where(upwards, up, -down)
    paths = [
        CubicVia(rest[m.v], target[m.v], rest[m.v], duration / 2, duration) if rest[m.v].size else None
        for m in robot.mounts
    ]
    return WholeBody(robot, Tangent(Circle(_RADIUS, _RATE, duration)), *paths)


def _lifts(robot: MobileRobot, way: Array) -> NDArray[np.bool_]:
    """Return for which coordinates a larger one lifts the arm, rather than pressing it into the base."""
    moves = np.diag(way)
    higher, lower = (robot.potential_energy(robot.integrate(robot.rest, sign * moves)) for sign in (1, -1))
    return higher >= lower - 1e-9


def list_mountable() -> int:
    """Print the names that can be mounted, and those that cannot, with the reason."""
    with progress(1, "reading every robot, without its meshes"):
        known = mountable()
    console.print(str(known), markup=False)
    console.print(f"{len(known)} robots; see one: pinmobile mount NAME --html out/NAME.html", markup=False)
    return 0


def show_mount(robot: MobileRobot, *, dt: float, duration: float, html: Path | None, out: Path | None) -> int:
    """Run both controllers, print the table, and write the page and the figures that were asked for."""
    folder = None if out is None else output_folder(out)
    positive("--duration", duration, "s")
    if html is not None:
        if html.suffix != ".html":
            raise InvalidArgument(f"--html is {str(html)!r}, expected a file that ends in .html")
        output_folder(html.parent, "--html", html)
    reference = demonstration(robot, duration)
    exact, decoupled = ComputedTorque(robot, *_GAINS), Decoupled(robot, *_GAINS)
    laws: dict[str, Controller] = {"computed torque": exact, "decoupled": decoupled}
    names = " and ".join(mount.name for mount in robot.mounts)
    figures = len(FIGURES) + len(_BALANCE) + 1 if folder is not None else 0
    with progress(len(laws) + (html is not None) + figures) as bar:
        runs, failures = _both(robot, laws, reference, dt, bar)
        unseen = [] if html is None else _unseen(robot)
        text = "\n".join([_head(robot, names, reference, dt), "", _table(runs), *failures, *unseen])
        if html is not None:
            begin(bar, "recording the scene")
            save_page(runs, html, f"{names} on the base: computed torque and decoupled")
        page = None if folder is None else _figures(runs, folder, names, text, bar)
    console.print(text, markup=False)
    console.print("\n" + "\n".join(_next(html, page)), markup=False)
    return 1 if any(failure.startswith("computed torque") for failure in failures) else 0


def _both(
    robot: MobileRobot, laws: Mapping[str, Controller], reference: WholeBody, dt: float, bar: Progress
) -> tuple[dict[str, Rollout], list[str]]:
    """Return the runs, of one that diverged its records until then, and what is to be said of those."""
    runs, failures = {}, []
    for name, law in laws.items():
        begin(bar, f"simulating {name}")
        try:
            runs[name] = simulate(robot, law, reference, dt=dt, integrator=rk4)
        except Diverged as error:
            if error.rollout is None:
                raise
            runs[name] = error.rollout
            failures.append(f"{name}: {error}; the table has what came before")
    return runs, failures


def _unseen(robot: MobileRobot) -> list[str]:
    """Return a line for each arm of which nothing is drawn."""
    drawn = [str(item.name) for item in robot.visual_model.geometryObjects]
    return [
        f"there is nothing to draw of {mount.name}: it has no visuals"
        for mount in robot.mounts
        if not any(name.startswith(f"{mount.name}/") for name in drawn)
    ]


def _head(robot: MobileRobot, names: str, reference: WholeBody, dt: float) -> str:
    total = sum(inertia.mass for inertia in robot.model.inertias)
    joints = f"{robot.nv - 3} joint{'' if robot.nv == 4 else 's'}"
    size = f"{joints}, {total:.1f} kg in all, M(q) is {robot.nv} x {robot.nv}"
    time = f"{reference.duration:g} s at dt = {dt:g} s, by rk4 in between"
    way = f"{_WAY['rad']:g} rad (a slide {_WAY['m']:g} m) and back"
    return (
        f"{names} on a box of {robot.mass:g} kg: {size}\n"
        f"{time}: the base drives a circle of {_RADIUS:g} m at {_RATE:g} rad/s,\n"
        f"each joint goes {way}, or as far as its limits allow"
    )


def _table(runs: Mapping[str, Rollout]) -> str:
    """Return the largest errors of base and arm, margin and friction, a column for each run."""
    columns = [_judged(run) for run in runs.values()]
    lines = [f"{'':32} " + " ".join(f"{name:>18}" for name in runs)]
    for row in columns[0]:
        lines.append(f"{row:32} " + " ".join(f"{column.get(row, '-'):>18}" for column in columns))
    return "\n".join(lines)


def _judged(run: Rollout) -> dict[str, str]:
    errors, units = run.max_error(), np.array([unit for _, unit in run.labels])
    rows = {f"largest error in {name} [{unit}]": errors[k] for k, (name, unit) in enumerate(run.labels[:3])}
    for unit in _WAY:
        of_joints = errors[3:][units[3:] == unit]
        if of_joints.size:
            rows[f"largest error of a joint [{unit}]"] = of_joints.max()
    shown = {name: in_words(value, ".3e") for name, value in rows.items()}
    margin, friction = float(tip_over_margin(run).min()), float(required_friction(run).max())
    shown["smallest tip-over margin [m]"] = _said(margin)
    shown["friction that it takes [-]"] = f"{friction:.3f}" if np.isfinite(friction) else "lifts off"
    return shown


def _said(margin: float) -> str:
    """Return a tip-over margin [m] in words: below zero, the zero-moment point is off the footprint."""
    if not np.isfinite(margin):
        return "tips over"
    return f"{margin:.3f}" if margin >= 0 else f"{margin:.3f}, tips over"


def _figures(runs: dict[str, Rollout], folder: Path, names: str, text: str, bar: Progress) -> Path:
    """Write records, figures and their index page, and return its path."""
    begin(bar, "recording")
    for label, run in runs.items():
        stem = label.replace(" ", "-")
        run.save(folder / f"{stem}.npz")
        run.to_csv(folder / f"{stem}.csv")
    pictures = draw(runs, folder, "", bar)
    for name, caption in _BALANCE.items():
        begin(bar, f"drawing {name}")
        save_figure(getattr(plots, name)(runs), folder / f"{name}.png")
        pictures.append(Picture(f"{name}.png", caption))
    return index_page(folder, f"{names} on the base", [Section("Results", text, pictures)])


def _next(html: Path | None, page: Path | None) -> list[str]:
    """Return what was written, and what to do next."""
    lines = []
    if html is not None:
        size = html.stat().st_size
        heavy = "; its meshes are fine, so a browser takes a while" if size > _HEAVY else ""
        lines += [f"recording: {size / 1e6:.1f} MB{heavy}", f"see it move: open {html}"]
    if page is not None:
        lines.append(f"figures and records: open {page}")
    if not lines:
        lines.append("see it move: add --html out/mount.html; figures and records: add --out out/mount")
    return lines
