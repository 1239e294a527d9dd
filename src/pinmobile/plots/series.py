"""Figures of rollouts over time: states, errors, inputs, signals, wheels on the ground, and balance."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, Unpack

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Polygon
from numpy.typing import NDArray

from pinmobile.arrays import Array, ArrayLike, instance
from pinmobile.balance import (
    body_zero_moment_point,
    contact_loads,
    footprint_of,
    reaction_wrench,
    required_friction,
    tip_over_margin,
)
from pinmobile.errors import InvalidArgument
from pinmobile.identification import Prediction
from pinmobile.loop import Rollout
from pinmobile.palette import INK, QUIET, SLIDES
from pinmobile.parts import Grounded, Touching
from pinmobile.plant import Contacts, Plant, configuration_names_of, coordinates_of, first_times, stated
from pinmobile.plots.style import (
    Layout,
    Rollouts,
    Sheet,
    Spot,
    Style,
    check_plants,
    colour,
    draw_curve,
    draw_line,
    dress,
    dress_time,
    font_size,
    ink,
    label_rollouts,
    label_style,
    legend_entries,
    line_style,
    name_of,
    reference_groups,
    reference_style,
    shade_steps,
    tint,
    wrap_label,
    wrap_text,
    write_over_titles,
)

_GROUND_REACTION = Grounded, "a MobileRobot, or a plant with ground_wrench(q, v, a)"
_SYMBOLS = {**{"x": "$x$", "y": "$y$", "psi": r"$\psi$"}, **{"Fx": "$F_x$", "Fy": "$F_y$", "Mz": "$M_z$"}}
_ROUNDING = 1e-12  # smaller values count as rounding errors


def states(rollouts: Rollouts, **layout: Unpack[Layout]) -> Figure:
    r"""Draw the configuration over time, desired and actual: x, y, psi and the joints of arms.

    Parameters
    ----------
    rollouts : Rollout or mapping of str to Rollout
        Rollouts by label, all in the same axes.
    title : str, optional
        Heading of the figure; "" for none; default: a heading that describes the figure.
    ax : Axes, sequence of Axes, Figure or SubFigure, optional
        Axes to draw in, one for each panel, or a figure to fill; default: a new figure.
    width : float, optional
        Width of a new figure [in]. Default: ``rcParams["figure.figsize"]`` if you changed it, otherwise a
        width that suits the panels. The height follows from the width. ``rcParams`` gives the font size.

    Returns
    -------
    figure : matplotlib.figure.Figure
        New figure, or the figure of ``ax``.

    Raises
    ------
    InvalidArgument
        If `rollouts`, `ax` or `width` is invalid, or the figure is too small for its labels.

    See Also
    --------
    plots.errors : desired minus actual configuration
    plots.path : the path from above

    Examples
    --------
    >>> from pinmobile import PD, Circle, MobileRobot, Tangent
    >>> from pinmobile import plots, simulate
    >>> robot = MobileRobot(mass=30.0, yaw_inertia=1.3)
    >>> motion = Tangent(Circle(1, 1, 2))
    >>> run = simulate(robot, PD(120, 120), motion, dt=0.02)
    >>> figure = plots.states(run)
    >>> [axes.get_ylabel() for axes in figure.axes]
    ['$x$ [m]', '$y$ [m]', '$\\psi$ [rad]']
    """
    runs = label_rollouts(rollouts)
    names = _panel_names((run.plant, _coordinate_names(run.plant, run.q.shape[1])) for run in runs.values())
    sheet, panels = _draw_runs(runs, names, lambda run: run.q, layout)
    for labels in reference_groups(runs).values():
        run = runs[labels[0]]
        draw(panels, run.t, run.reference.q, label="desired", **reference_style())
    keys = [Line2D([], [], label="desired", **reference_style()), *legend_entries(runs, "actual")]
    return sheet.finish("Desired and actual pose", keys)


def errors(rollouts: Rollouts, **layout: Unpack[Layout]) -> Figure:
    """Draw the error over time: desired minus actual configuration, with angles on the circle.

    Errors of controllers differ by orders of magnitude. Each rollout therefore has a column with separate
    scales. The title of each panel gives the largest absolute error.

    Parameters
    ----------
    rollouts : Rollout or mapping of str to Rollout
        Rollouts by label, one column each.
    **layout
        ``title``, ``ax`` and ``width``, see `plots.states`.

    Returns
    -------
    figure : matplotlib.figure.Figure
        New figure, or the figure of ``ax``.

    Raises
    ------
    InvalidArgument
        If `rollouts`, ``ax`` or ``width`` is invalid, or the figure is too small for its labels.

    See Also
    --------
    plots.states : desired and actual configuration
    Rollout.max_error : the largest errors as numbers

    Examples
    --------
    >>> from pinmobile import PD, Circle, MobileRobot, Tangent
    >>> from pinmobile import plots, simulate
    >>> robot = MobileRobot(mass=30.0, yaw_inertia=1.3)
    >>> motion = Tangent(Circle(1, 1, 2))
    >>> run = simulate(robot, PD(120, 120), motion, dt=0.02)
    >>> figure = plots.errors(run)
    >>> figure.axes[0].get_title(loc="right")
    'largest 0.187 m'
    """
    runs = label_rollouts(rollouts)
    names = _panel_names((run.plant, run.labels) for run in runs.values())
    note = "; each panel has its own scale" if len(runs) > 1 else ""
    dense = len(names) > _MAX_ROWS
    sheet = Sheet(max(9.0, (4.2 if dense else 3.2) * len(runs)), **layout)
    grid = _stack(sheet, names if dense else [(f"error in {name}", unit) for name, unit in names], len(runs))
    for index, (label, run) in enumerate(runs.items()):
        column = grid[:, index]
        draw(column, run.t, run.error, **line_style(0, 1) | {"color": colour(index)})
        mark_events(column, run, colour(index))
        room = sheet.room() / (1 + dense)
        for axes, (_, unit), values in zip(column, names, run.error.T, strict=False):
            largest = f"largest {_format_power(float(np.abs(values).max()))} {unit}"
            axes.set_title(wrap_text(largest, font_size(0.95), room), fontsize=font_size(0.95), loc="right")
        write_over_titles(column[0], wrap_label(sheet, label), **label_style(index))
    return sheet.finish(f"Error: desired minus actual{note}")


def forces(rollouts: Rollouts, **layout: Unpack[Layout]) -> Figure:
    """Draw the inputs of the plant over time, such as forces and torques.

    Inputs are constant between samples.

    Parameters
    ----------
    rollouts : Rollout or mapping of str to Rollout
        Rollouts by label, all in the same axes.
    **layout
        ``title``, ``ax`` and ``width``, see `plots.states`.

    Returns
    -------
    figure : matplotlib.figure.Figure
        New figure, or the figure of ``ax``.

    Raises
    ------
    InvalidArgument
        If `rollouts`, ``ax`` or ``width`` is invalid, or the figure is too small for its labels.

    See Also
    --------
    plots.wheel_torques : inputs of wheels and steering axes
    plots.states : the resulting motion

    Examples
    --------
    >>> from pinmobile import PD, Circle, MobileRobot, Tangent
    >>> from pinmobile import plots, simulate
    >>> robot = MobileRobot(mass=30.0, yaw_inertia=1.3)
    >>> motion = Tangent(Circle(1, 1, 2))
    >>> run = simulate(robot, PD(120, 120), motion, dt=0.02)
    >>> figure = plots.forces(run)
    >>> [axes.get_ylabel() for axes in figure.axes]
    ['$F_x$ [N]', '$F_y$ [N]', '$M_z$ [N m]']
    """
    runs = label_rollouts(rollouts)
    names = _panel_names((run.plant, [(one.name, one.unit) for one in run.inputs]) for run in runs.values())
    sheet, _ = _draw_runs(runs, names, lambda run: run.u, layout, drawstyle="steps-post")
    return sheet.finish("Input, held from one sample to the next", legend_entries(runs))


def signals(rollouts: Rollouts, **layout: Unpack[Layout]) -> Figure:
    """Draw the signals that parts of the loop recorded, each with its unit.

    Parameters
    ----------
    rollouts : Rollout or mapping of str to Rollout
        Rollouts by label, all in the same axes. Each signal has a panel.
    **layout
        ``title``, ``ax`` and ``width``, see `plots.states`.

    Returns
    -------
    figure : matplotlib.figure.Figure
        New figure, or the figure of ``ax``.

    Raises
    ------
    InvalidArgument
        If `rollouts` is invalid, or no rollout has a signal.

    See Also
    --------
    Rollout.signals : the signals as numbers
    plots.odometry : estimated beside true pose

    Examples
    --------
    >>> from pinmobile import Circle, ComputedTorque, MobileRobot
    >>> from pinmobile import DisturbanceObserver, Tangent
    >>> from pinmobile import plots, simulate
    >>> robot = MobileRobot(mass=30.0, yaw_inertia=1.3)
    >>> law = DisturbanceObserver(ComputedTorque(robot), robot)
    >>> motion = Tangent(Circle(1, 1, 1))
    >>> run = simulate(robot, law, motion, dt=0.02)
    >>> figure = plots.signals(run)
    >>> [axes.get_ylabel() for axes in figure.axes]
    ['disturbance [N, N m]']
    """
    runs = label_rollouts(rollouts)
    units = {name: unit for run in runs.values() for name, (unit, _) in run.signals.items()}
    if not units:
        raise InvalidArgument("rollouts have no signals, expected at least one: see Rollout.signals")
    sheet, panels = _make_panels([(_symbol(name), unit) for name, unit in units.items()], layout)
    max_size = max(values[0].size for run in runs.values() for _, values in run.signals.values())

    def style(index: int, k: int, count: int) -> Style:
        """Return a style: dashes distinguish runs, and colours distinguish entries of a signal."""
        if max_size == 1:
            return line_style(index, len(runs))
        return {**line_style(index, len(runs)), "color": colour(k) if count > 1 else ink()}

    for axes, name in zip(panels, units, strict=True):
        for index, run in enumerate(runs.values()):
            if name in run.signals:
                values = run.signals[name].values.reshape(len(run), -1)
                for k, column in enumerate(values.T):
                    draw([axes], run.t, column[:, None], **style(index, k, values.shape[1]))
    labels = enumerate(runs) if len(runs) > 1 else ()
    keys = [Line2D([], [], label=label, **style(index, 0, 1)) for index, label in labels]
    if max_size > 1:
        keys += [Line2D([], [], label=f"[{k}]", color=colour(k), linewidth=3.0) for k in range(max_size)]
    return sheet.finish("Signals", keys)


_EVENT_TOLERANCE = 0.1  # share of the duration within which events have one mark
_MAX_ROWS = 6  # largest number of rows with labels beside the axes; more rows have labels above the axes


def _draw_runs(
    runs: Mapping[str, Rollout],
    names: Sequence[tuple[str, str]],
    values: Callable[[Rollout], Array],
    layout: Layout,
    **style: Any,
) -> tuple[Sheet, list[Axes]]:
    """Draw a line of each rollout in the axes of each name, and return the sheet and the axes."""
    (sheet, panels), line = _make_panels(names, layout), 0
    for index, run in enumerate(runs.values()):
        draw(panels, run.t, values(run), **style, **line_style(index, len(runs)))
        line += mark_events(panels, run, line_style(index, len(runs))["color"], line=line)
    return sheet, panels


def mark_events(panels: Iterable[Axes], run: Rollout, color: Any, *, line: int = 0) -> int:
    """Draw a line at the first sample of each kind of event, and return the number of marks.

    Their names stand in the first panel, each mark's in a line of its own, from line number `line` on.
    """
    times: dict[float, list[str]] = {}
    for kind, t in first_times(run.events).items():
        mark = next((each for each in times if t - each < _EVENT_TOLERANCE * run.t[-1]), t)
        times.setdefault(mark, []).append(kind)
    for row, axes in enumerate(panels):
        for k, (t, kinds) in enumerate(times.items(), start=line):
            axes.axvline(t, color=color, linewidth=1.0, linestyle=":", zorder=2)
            if row == 0:
                flips = t > run.t[-1] / 2
                style: Any = {"ha": "right" if flips else "left", "va": "top", "textcoords": "offset points"}
                size = font_size(0.85)
                style |= {"xytext": (-3 if flips else 3, -2 - 1.2 * size * k)}
                style |= {"xycoords": ("data", "axes fraction"), "fontsize": size, "color": color}
                ground = {"facecolor": axes.get_facecolor(), "alpha": 0.7, "pad": 0.5, "linewidth": 0}
                axes.annotate(", ".join(kinds), (t, 1), bbox=ground, zorder=6, **style)
    return len(times)


def _make_panels(names: Sequence[tuple[str, str]], layout: Layout) -> tuple[Sheet, list[Axes]]:
    """Return a sheet with axes for each name and unit: one column, or up to three columns for many names."""
    count = len(names)
    sheet = Sheet(9.0 if count <= _MAX_ROWS else 12.0, **layout)
    if count <= _MAX_ROWS:
        panels = list(_stack(sheet, names, 1)[:, 0])
    else:
        columns = sheet.columns(3, 2.4)
        panels = sheet.axes([divmod(k, columns) for k in range(count)], [1.75] * -(-count // columns))
        _style_time_axes(sheet, np.array([panels]))
        for k, (axes, name) in enumerate(zip(panels, names, strict=True)):
            _label_axes(sheet, axes, name)
            axes.set_xlabel("t [s]" if k + columns >= count else "")
    return sheet, panels


def _stack(sheet: Sheet, names: Sequence[tuple[str, str]], columns: int) -> NDArray[Any]:
    """Return axes, shape (rows, columns), one row for each name; many rows have labels above the axes."""
    dense = len(names) > _MAX_ROWS
    grid = sheet.grid(len(names), columns, [1.2 if dense else 1.75] * len(names))
    for row, (name, unit) in zip(grid, names, strict=True):
        row[0].set_ylabel(f"{name} [{unit}]" if unit else name)
        for axes in row if dense else ():
            _label_axes(sheet, axes, (name, unit), 2)  # beside the largest error
    return _style_time_axes(sheet, grid)


def _label_axes(sheet: Sheet, axes: Axes, name: tuple[str, str], parts: int = 1) -> None:
    axes.set_title(wrap_text(name[0], font_size(), sheet.room(parts)), fontsize=font_size(), loc="left")
    axes.set_ylabel(f"[{name[1]}]" if name[1] else "")


def _style_time_axes(sheet: Sheet, grid: NDArray[Any]) -> NDArray[Any]:
    for axes in grid.ravel():
        dress_time(axes)
        axes.ticklabel_format(axis="y", scilimits=(-3, 4), useMathText=True)
    for axes in grid[-1]:
        axes.set_xlabel("t [s]")
    if sheet.is_new:
        sheet.figure.align_ylabels(grid[:, 0])
    return grid


def _panel_names(candidates: Iterable[tuple[object, Sequence[tuple[str, str]]]]) -> list[tuple[str, str]]:
    """Return symbol and units for each panel, from the first plant with the largest number of columns."""
    every = list(candidates)
    plant, pairs = max(every, key=lambda one: len(one[1]))
    single = len(getattr(plant, "mounts", ())) == 1
    units = [dict.fromkeys(each[k][1] for _, each in every if k < len(each)) for k in range(len(pairs))]
    names = [_symbol(name.partition("/")[2] or name if single else name) for name, _ in pairs]
    return [(name, " or ".join(filter(None, unit))) for name, unit in zip(names, units, strict=True)]


def _symbol(name: str) -> str:
    """Return the axis label of a name."""
    return _SYMBOLS.get(name, name.removesuffix("_joint").replace("_", " ").replace("$", r"\$"))


def _coordinate_names(plant: Plant | None, count: int) -> list[tuple[str, str]]:
    """Return name and unit of each entry of q."""
    coordinates = coordinates_of(plant)
    if len(coordinates) == count:
        return [(one.name, one.unit) for one in coordinates]
    units = {one.name: one.unit for one in coordinates}
    names = configuration_names_of(plant) or [f"[{k}]" for k in range(count)]
    return [(name, units.get(name, "")) for name in names]


def draw(column: Iterable[Axes], t: Array, rows: Array, **style: Any) -> None:
    """Draw each column of `rows`, shape (N, n), in its axes."""
    for axes, values in zip(column, rows.T, strict=False):
        draw_line(axes, t, values, **style)
        if np.abs(axes.dataLim.intervaly).max() < _ROUNDING:
            axes.set_ylim(-_ROUNDING, _ROUNDING)


def _format_power(value: float) -> str:
    if value == 0 or 0.01 <= value < 1000:
        return f"{value:.3g}"
    if value < _ROUNDING:
        return r"$< 10^{-12}$"
    mantissa, exponent = f"{value:.2e}".split("e")
    return rf"${mantissa}\cdot 10^{{{int(exponent)}}}$"


_WRENCH = [(f"${kind}_{axis}$", unit) for kind, unit in (("f", "N"), ("m", "N m")) for axis in "xyz"]


def reaction(rollouts: Rollouts, *, mount: str | None = None, **layout: Unpack[Layout]) -> Figure:
    """Draw the force and the moment of an arm on the base over time, along the body axes.

    Parameters
    ----------
    rollouts : Rollout or mapping of str to Rollout
        Rollouts by label, all in the same axes.
    mount : str, optional
        Name of the mount, see `balance.reaction_wrench`; default: the only arm.
    **layout
        ``title``, ``ax`` and ``width``, see `plots.states`.

    Returns
    -------
    figure : matplotlib.figure.Figure
        New figure, or the figure of ``ax``.

    Raises
    ------
    InvalidArgument
        If `rollouts` is invalid, or the plant is not a `MobileRobot` with an arm.
    UnknownName
        If there is no mount of this name.

    See Also
    --------
    balance.reaction_wrench : the same as numbers
    plots.balance : effect on tip-over margin and friction

    Examples
    --------
    >>> from pinmobile import FixedHeading, Hold, MobileRobot
    >>> from pinmobile import PDGravity, WholeBody, plots, simulate
    >>> robot = MobileRobot.box().mount("ur5")
    >>> base = FixedHeading(Hold((0, 0), duration=0.1), psi=0)
    >>> still = WholeBody(robot, base, Hold(robot.rest[3:], 0.1))
    >>> law = PDGravity(robot, 100, 20)
    >>> run = simulate(robot, law, still, dt=0.01)
    >>> figure = plots.reaction(run)
    >>> figure.axes[2].get_ylabel()
    '$f_z$ [N]'
    """
    runs = check_plants(rollouts, *_GROUND_REACTION)
    sheet, _ = _draw_runs(runs, _WRENCH, lambda run: reaction_wrench(run, mount), layout)
    return sheet.finish("Force and moment of the arm on the base, at its mount", legend_entries(runs))


_MEASURED_STYLE: Style = {"color": "#9a9a9a", "linewidth": 3.2, "solid_capstyle": "round"}
_DEVIATIONS = 2.0  # standard deviations that contain 95 % of the differences
_MAX_POINTS = 4000  # largest number of points of a line


def prediction(foretold: Prediction, **layout: Unpack[Layout]) -> Figure:
    """Draw measured and predicted values, and their difference beside the sensor noise.

    Each segment of the prediction has a separate initial state. The band contains 95 % of the differences if
    only sensor noise remains.

    Parameters
    ----------
    foretold : Prediction
        Result of ``predict`` of an `identification.Identification`.
    **layout
        ``title``, ``ax`` and ``width``, see `plots.states`. Axes are pairs for each measurement: values, then
        differences.

    Returns
    -------
    figure : matplotlib.figure.Figure
        New figure, or the figure of ``ax``.

    Raises
    ------
    InvalidArgument
        If `foretold` is not a prediction, or ``ax`` or ``width`` is invalid.

    See Also
    --------
    identify : estimate parameters
    identification.Prediction : the numbers

    Examples
    --------
    >>> from pinmobile import FixedHeading, Hold, Log, VelocityRobot
    >>> from pinmobile import identify_velocity, plots, simulate
    >>> from pinmobile.controllers import RandomSteps
    >>> robot = VelocityRobot([0.4, 0.3, 0.0, 1.0, 0.0, 1.0])
    >>> still = FixedHeading(Hold((0, 0), duration=44), psi=0)
    >>> run = simulate(robot, RandomSteps(), still, dt=0.1)
    >>> log = Log.from_rollout(run, noise=1e-4)
    >>> found = identify_velocity(log, delay=0.0)
    >>> figure = plots.prediction(found.predict(log))
    >>> [axes.get_ylabel() for axes in figure.axes[:2]]
    ['x [m]', 'difference [mm]']
    """
    instance("foretold", foretold, Prediction, "a Prediction, the result of predict() of an Identification")
    sheet = Sheet(10.0, **layout)
    grid = sheet.grid(len(foretold.names), 2, [1.7] * len(foretold.names))
    t = _join_segments(foretold.t)
    samples = np.arange(0, t.size, max(1, t.size // _MAX_POINTS))
    for axes in grid.ravel():
        dress(axes)
    for k, (name, unit) in enumerate(zip(foretold.names, foretold.units, strict=True)):
        (values, differences), small = grid[k], f"m{unit}"
        measured, predicted = foretold.measured[..., k], foretold.predicted[..., k]
        values.plot(t[samples], _join_segments(measured)[samples], **_MEASURED_STYLE)
        values.plot(t[samples], _join_segments(predicted)[samples], color=colour(0), linewidth=1.4)
        values.set_ylabel(f"{_SYMBOLS[name] if name == 'psi' else name} [{unit}]")
        noise = 1e3 * foretold.noise[k]
        band = _DEVIATIONS * noise
        differences.axhspan(-band, band, color=tint(ink(), 0.12), linewidth=0)
        residual = 1e3 * _join_segments(measured - predicted)
        differences.plot(t[samples], residual[samples], color=colour(0), linewidth=0.7)
        differences.set_ylabel(f"difference [{small}]")
        summary = f"rms {1e3 * foretold.rms[k]:.2g} {small}, noise {noise:.2g} {small}"
        sheet.write_above(differences, summary, 0.95, loc="left")
    for axes in grid[-1]:
        axes.set_xlabel("t [s]")
    keys = [
        Line2D([], [], label="measured", **_MEASURED_STYLE),
        Line2D([], [], label="predicted", color=colour(0), linewidth=1.4),
        Patch(color=tint(ink(), 0.12), label="sensor noise, 95 %"),
    ]
    span = float(foretold.t[0, -1] - foretold.t[0, 0])
    return sheet.finish(f"Measured and predicted, {span:.3g} s ahead", keys)


def _join_segments(segments: Array) -> Array:
    """Return segments as one line with gaps between them, shape (S (L + 1),)."""
    gap = np.full((len(segments), 1), np.nan)
    return np.asarray(np.concatenate([segments, gap], axis=1).ravel())


_WHEEL_CONTACTS = Touching, "a WheeledRobot, or a plant with contacts(q, v, a, u, signals)"
_WIDTH, _HEIGHT = 5.0, 2.2  # of axes [in]
_LIMIT_STYLE: Style = {"color": INK, "linestyle": (0, (4, 3)), "linewidth": 1.2, "zorder": 2}
_SLIP_STYLE: Style = {"facecolor": SLIDES, "alpha": 0.15, "zorder": 1}
_ZERO_TOLERANCE = 1e-9  # smaller values are drawn as zero


def wheel_torques(rollouts: Rollouts, **layout: Unpack[Layout]) -> Figure:
    """Draw the inputs of wheels over time, torques or voltages, and those of steering axes below.

    `plots.forces` shows the inputs of arms too.

    Parameters
    ----------
    rollouts : Rollout or mapping of str to Rollout
        Rollouts by label, one column each.
    **layout
        ``title``, ``ax`` and ``width``, see `plots.states`.

    Returns
    -------
    figure : matplotlib.figure.Figure
        New figure, or the figure of ``ax``.

    Raises
    ------
    InvalidArgument
        If `rollouts` is invalid, or a plant is not a robot on wheels.

    See Also
    --------
    plots.forces : all inputs
    plots.friction : forces of the wheels on the ground

    Examples
    --------
    >>> from pinmobile import PD, Circle, ControlAllocation
    >>> from pinmobile import MobileRobot, Tangent, WheeledRobot
    >>> from pinmobile import WheelTable, plots, simulate
    >>> table = WheelTable.differential(
    ...     track=0.5, radius=0.1, supports=[(0.2, 0)])
    >>> robot = WheeledRobot(MobileRobot(30.0, 1.3), table)
    >>> law = ControlAllocation(PD(120, 120), robot)
    >>> motion = Tangent(Circle(1, 1, 1))
    >>> run = simulate(robot, law, motion, dt=0.05)
    >>> figure = plots.wheel_torques(run)
    >>> [line.get_label() for line in figure.axes[0].lines]
    ['left', 'right']
    """
    runs = check_plants(rollouts, *_WHEEL_CONTACTS)
    inputs = [_wheel_inputs(run) for run in runs.values()]
    units = {one.unit for each in inputs for one in each}
    word = "voltage" if units == {"V"} else "torque"
    name = f"{word} [{units.pop()}]" if len(units) == 1 else "input"
    turns = [_steering_names(run) for run in runs.values()]
    rows = sorted({one.name in names for each, names in zip(inputs, turns, strict=True) for one in each})
    sheet, grid = _make_axes(runs, ["steering " * row + name for row in rows], layout)
    for run, each, names, column in zip(runs.values(), inputs, turns, grid.T, strict=True):
        u = run.u[:, run.u.shape[1] - len(each) :]
        for row, axes in zip(rows, column, strict=True):
            k = [j for j, one in enumerate(each) if (one.name in names) == row]
            if k:
                _draw_lines(sheet, axes, run.t, u[:, k], [each[j].name for j in k], drawstyle="steps-post")
    return sheet.finish("Inputs of the wheels")


def friction(rollouts: Rollouts, **layout: Unpack[Layout]) -> Figure:
    r"""Draw the used share of the friction of each wheel over time.

    The share is the force of the ground in the plane divided by the largest friction mu N. A wheel slides at
    share 1. For wheels with rollers, the force is along the axes of the rollers. If the model determines only
    the sum of some forces, a wheel gets its share of the sum.

    Parameters
    ----------
    rollouts : Rollout or mapping of str to Rollout
        Rollouts by label, one column each.
    **layout
        ``title``, ``ax`` and ``width``, see `plots.states`.

    Returns
    -------
    figure : matplotlib.figure.Figure
        New figure, or the figure of ``ax``.

    Raises
    ------
    InvalidArgument
        If `rollouts` is invalid, a plant is not a robot on wheels, or its loads are unknown.

    See Also
    --------
    plots.loads : normal forces
    plots.slip : slip velocities

    Examples
    --------
    >>> from pinmobile import PD, Circle, ControlAllocation
    >>> from pinmobile import MobileRobot, Tangent, WheeledRobot
    >>> from pinmobile import WheelTable, plots, simulate
    >>> table = WheelTable.differential(
    ...     track=0.5, radius=0.1, supports=[(0.2, 0)])
    >>> robot = WheeledRobot(MobileRobot(30.0, 1.3), table)
    >>> law = ControlAllocation(PD(120, 120), robot)
    >>> motion = Tangent(Circle(1, 1, 1))
    >>> run = simulate(robot, law, motion, dt=0.05)
    >>> figure = plots.friction(run)
    >>> figure.axes[0].get_ylabel()
    'force / $\\mu N$ [-]'
    """
    runs = check_plants(rollouts, *_WHEEL_CONTACTS)
    all_contacts = {label: _contacts(run) for label, run in runs.items()}
    for label, contacts in all_contacts.items():
        if not np.isfinite(contacts.limits).any():
            raise InvalidArgument(
                f"{name_of(label)} has a robot with unknown loads, expected contacts at three or more "
                "points: give supports=[(x, y), ...]"
            )
    sheet, grid = _make_axes(runs, ["force / $\\mu N$ [-]"], layout)
    for run, contacts, axes in zip(runs.values(), all_contacts.values(), grid[0], strict=True):
        pairs = zip(contacts.names, np.asarray(contacts.determined.all(axis=1)), strict=True)
        names = [name if is_known else f"{name} (share)" for name, is_known in pairs]
        _draw_lines(sheet, axes, run.t, share_of_friction(contacts), names)
        axes.axhline(1.0, **_LIMIT_STYLE)
        _write_note(axes, "slides", (1.0, 1.0), "right", ("axes fraction", "data"))
        shade_steps([axes], run.t, np.asarray(contacts.slides.any(axis=1)), **_SLIP_STYLE)
        axes.set_ylim(0.0, max(1.12, axes.get_ylim()[1]))
    return sheet.finish("Share of friction used")


def slip(rollouts: Rollouts, **layout: Unpack[Layout]) -> Figure:
    """Draw the slip velocity of each wheel over time, along the wheel and across it.

    For a wheel with rollers, the first direction is along the axes of the rollers. The second is across them:
    the rollers roll in this direction.

    Parameters
    ----------
    rollouts : Rollout or mapping of str to Rollout
        Rollouts by label, one column each.
    **layout
        ``title``, ``ax`` and ``width``, see `plots.states`.

    Returns
    -------
    figure : matplotlib.figure.Figure
        New figure, or the figure of ``ax``.

    Raises
    ------
    InvalidArgument
        If `rollouts` is invalid, or a plant is not a robot on wheels.

    See Also
    --------
    plots.friction : used share of friction
    Coulomb : ground on which wheels slip

    Examples
    --------
    >>> from pinmobile import PD, Circle, ControlAllocation
    >>> from pinmobile import MobileRobot, Tangent, WheeledRobot
    >>> from pinmobile import WheelTable, plots, simulate
    >>> table = WheelTable.differential(
    ...     track=0.5, radius=0.1, supports=[(0.2, 0)])
    >>> robot = WheeledRobot(MobileRobot(30.0, 1.3), table)
    >>> law = ControlAllocation(PD(120, 120), robot)
    >>> motion = Tangent(Circle(1, 1, 1))
    >>> run = simulate(robot, law, motion, dt=0.05)
    >>> figure = plots.slip(run)
    >>> [axes.get_ylabel() for axes in figure.axes]
    ['slip along [m/s]', 'slip across [m/s]']
    """
    runs = check_plants(rollouts, *_WHEEL_CONTACTS)
    sheet, grid = _make_axes(runs, ["slip along [m/s]", "slip across [m/s]"], layout)
    for run, column in zip(runs.values(), grid.T, strict=True):
        contacts = _contacts(run)
        for k, axes in enumerate(column):
            values = np.where(np.abs(contacts.slips[..., k]) < _ZERO_TOLERANCE, 0.0, contacts.slips[..., k])
            _draw_lines(sheet if k == 0 else None, axes, run.t, values, contacts.names)
            shade_steps([axes], run.t, np.asarray(contacts.slides.any(axis=1)), **_SLIP_STYLE)
            if not values.any():
                axes.set_ylim(-1.0, 1.0)
                _write_note(axes, "none", (0.5, 0.62))
    return sheet.finish("Slip velocities")


def loads(rollouts: Rollouts, **layout: Unpack[Layout]) -> Figure:
    """Draw the load (normal force) of each wheel and support over time.

    Parameters
    ----------
    rollouts : Rollout or mapping of str to Rollout
        Rollouts by label, one column each.
    **layout
        ``title``, ``ax`` and ``width``, see `plots.states`.

    Returns
    -------
    figure : matplotlib.figure.Figure
        New figure, or the figure of ``ax``.

    Raises
    ------
    InvalidArgument
        If `rollouts` is invalid, or a plant is not a robot on wheels.

    See Also
    --------
    plots.friction : used share of friction
    plots.balance : tip-over margin

    Examples
    --------
    >>> from pinmobile import PD, Circle, ControlAllocation
    >>> from pinmobile import MobileRobot, Tangent, WheeledRobot
    >>> from pinmobile import WheelTable, plots, simulate
    >>> table = WheelTable.differential(
    ...     track=0.5, radius=0.1, supports=[(0.2, 0)])
    >>> robot = WheeledRobot(MobileRobot(30.0, 1.3), table)
    >>> law = ControlAllocation(PD(120, 120), robot)
    >>> motion = Tangent(Circle(1, 1, 1))
    >>> run = simulate(robot, law, motion, dt=0.05)
    >>> figure = plots.loads(run)
    >>> round(figure.axes[0].lines[0].get_ydata()[0])  # [N]
    147
    """
    runs = check_plants(rollouts, *_WHEEL_CONTACTS)
    sheet, grid = _make_axes(runs, ["load [N]"], layout)
    for run, axes in zip(runs.values(), grid[0], strict=True):
        contacts = _contacts(run)
        names, values, is_known = contacts.names, contacts.loads, np.isfinite(contacts.loads).any()
        if is_known and stated(run.plant, "contact_loads"):  # with supports
            names, values, *_ = contact_loads(run)
            values = run.signals["loads"].values if "loads" in run.signals else values
        _draw_lines(sheet, axes, run.t, values, names)
        if not is_known:
            _write_note(axes, "unknown", (0.5, 0.5))
        axes.set_ylim(bottom=min(0.0, axes.get_ylim()[0]))
        mark_events([axes], run, ink())
    return sheet.finish("Loads of wheels and supports")


def odometry(rollouts: Rollouts, **layout: Unpack[Layout]) -> Figure:
    """Draw the pose that odometry estimates beside the true pose, and their distance over time.

    Parameters
    ----------
    rollouts : Rollout or mapping of str to Rollout
        Rollouts by label with the controller `wheels.OdometryFeedback`, one column each.
    **layout
        ``title``, ``ax`` and ``width``, see `plots.states`.

    Returns
    -------
    figure : matplotlib.figure.Figure
        New figure, or the figure of ``ax``.

    Raises
    ------
    InvalidArgument
        If `rollouts` is invalid, or a rollout has no signal ``believed_pose``.

    See Also
    --------
    wheels.OdometryFeedback : controller with pose from odometry
    plots.path : desired and travelled path

    Examples
    --------
    >>> from pinmobile import Backstepping, Circle, MobileRobot
    >>> from pinmobile import Tangent, UnicycleTracking, WheeledRobot
    >>> from pinmobile import WheelTable, plots, simulate, wheels
    >>> table = WheelTable.differential(
    ...     track=0.5, radius=0.1, supports=[(0.2, 0)])
    >>> robot = WheeledRobot(MobileRobot(30.0, 1.3), table)
    >>> law = Backstepping(UnicycleTracking(), robot)
    >>> law = wheels.OdometryFeedback(law, table)
    >>> motion = Tangent(Circle(1, 1, 1))
    >>> run = simulate(robot, law, motion, dt=0.02)
    >>> figure = plots.odometry(run)
    >>> [line.get_label() for line in figure.axes[0].lines]
    ['desired', 'true', 'believed']
    """
    runs = label_rollouts(rollouts)
    for label, run in runs.items():
        if "believed_pose" not in run.signals:
            expected = "a run with OdometryFeedback(controller, table)"
            raise InvalidArgument(f"{name_of(label)} has no signal believed_pose, expected {expected}")
    sheet, grid = _make_axes(runs, ["y [m]", "odometry off by [m]"], layout, 1.7)
    for run, (plane, error_axes) in zip(runs.values(), grid.T, strict=True):
        true, estimated = run.poses, run.signals["believed_pose"].values
        draw_curve(plane, *run.reference_poses[:, :2].T, label="desired", **reference_style())
        for k, (label, poses) in enumerate((("true", true), ("believed", estimated))):
            draw_curve(plane, *poses[:, :2].T, label=label, **line_style(k, 2))
        plane.set_aspect("equal", adjustable="datalim")
        plane.set_xlabel("x [m]")
        plane.legend(frameon=False, loc="best")
        distances = np.hypot(*(estimated - true)[:, :2].T)
        draw_line(error_axes, run.t, distances, **line_style(0, 1) | {"color": colour(1)})
        error_axes.set_ylim(bottom=0.0)
    return sheet.finish("Odometry beside the truth")


def share_of_friction(contacts: Contacts) -> Array:
    """Return the used share of the friction of each contact, shape (n, k); NaN if unknown.

    For a wheel with rollers, the share is along the axes of the rollers: the rollers roll across them.
    """
    with np.errstate(invalid="ignore", divide="ignore"):
        shares = np.where(contacts.forces == 0, 0.0, contacts.forces / contacts.limits)
    rolls = contacts.limits[..., 0] != contacts.limits[..., 1]
    return np.asarray(np.where(rolls, np.abs(shares[..., 0]), np.hypot(shares[..., 0], shares[..., 1])))


def _contacts(run: Rollout) -> Contacts:
    plant: Any = run.plant
    contacts: Contacts = plant.contacts(run.q, run.v, run.a, run.u, run.signals)
    return contacts


def _wheel_inputs(run: Rollout) -> Sequence[Any]:
    """Return the inputs after the inputs of the arms."""
    body: Any = getattr(run.plant, "robot", None)
    return run.inputs[max(len(coordinates_of(body)) - 3, 0) :]


def _steering_names(run: Rollout) -> set[str]:
    table = getattr(run.plant, "table", None)
    return set() if table is None else {axis.name for axis in table.axes}


def _make_axes(
    runs: dict[str, Rollout], rows: Sequence[str], layout: Layout, height_ratio: float = 1.0
) -> tuple[Sheet, NDArray[Any]]:
    """Return a sheet with a column for each run, and the axes, shape (rows, runs)."""
    sheet = Sheet(_WIDTH * len(runs), **layout)
    heights = [_HEIGHT * height_ratio, *(_HEIGHT for _ in rows[1:])]
    grid = sheet.grid(len(rows), len(runs), heights, share="")
    for row, name in zip(grid, rows, strict=True):
        row[0].set_ylabel(name)
    for axes in grid.ravel():
        dress_time(axes)
    for (label, run), column in zip(runs.items(), grid.T, strict=True):
        sheet.write_above(column[0], label)
        column[-1].set_xlabel("t [s]")
        if len(run) > 1:
            for axes in column if height_ratio == 1.0 else column[1:]:
                axes.set_xlim(run.t[0], run.t[-1])
    return sheet, grid


def _draw_lines(
    sheet: Sheet | None, axes: Axes, t: Array, values: Array, names: Sequence[str], **style: Any
) -> None:
    """Draw a line for each wheel and, with a sheet, a legend; the first line is the widest."""
    for k, (name, column) in enumerate(zip(names, values.T, strict=True)):
        draw_line(axes, t, column, label=name.replace("_", " "), **line_style(k, len(names)) | style)
    if float(np.nanmax(np.abs(values), initial=0.0)) < _ZERO_TOLERANCE:
        axes.set_ylim(-1.0, 1.0)
    if sheet is not None:
        sheet.place_legend(axes)


def _write_note(
    axes: Axes, words: str, position: tuple[float, float], ha: str = "center", xycoords: Any = "axes fraction"
) -> None:
    style: Style = {"fontsize": font_size(0.9), "color": QUIET}
    axes.annotate(words, position, (0, 3), xycoords=xycoords, textcoords="offset points", ha=ha, **style)


_OUTLINE_STYLE: Style = {"facecolor": "#f2f2f2", "edgecolor": "#777777", "linewidth": 1.4, "zorder": 1}


def balance(rollouts: Rollouts, *, footprint: ArrayLike | None = None, **layout: Unpack[Layout]) -> Figure:
    """Draw tip-over margin and required friction over time, and the zero-moment point.

    Parameters
    ----------
    rollouts : Rollout or mapping of str to Rollout
        Rollouts by label, all in the same axes.
    footprint : array_like, shape (k, 2), optional
        Corners of the support polygon in the body frame [m], see `balance.tip_over_margin`; default: the
        footprint of each robot.
    **layout
        ``title``, ``ax`` and ``width``, see `plots.states`.

    Returns
    -------
    figure : matplotlib.figure.Figure
        New figure, or the figure of ``ax``.

    Raises
    ------
    InvalidArgument
        If `rollouts` is invalid, a plant has no ground reaction, or `footprint` is not a convex polygon.

    See Also
    --------
    balance.tip_over_margin : the margin as numbers
    balance.required_friction : the friction as numbers
    plots.loads : loads of wheels

    Examples
    --------
    >>> from pinmobile import PD, Circle, MobileRobot, Tangent
    >>> from pinmobile import plots, simulate
    >>> robot = MobileRobot(mass=30.0, yaw_inertia=1.3)
    >>> motion = Tangent(Circle(1, 1, 2))
    >>> run = simulate(robot, PD(120, 120), motion, dt=0.02)
    >>> figure = plots.balance(run)
    >>> [axes.get_ylabel() for axes in figure.axes[:2]]
    ['tip-over margin [m]', 'required friction [-]']
    """
    runs = check_plants(rollouts, *_GROUND_REACTION)
    sheet = Sheet(11.0, **layout)
    if sheet.columns(2, 3.2) == 1:
        upper, lower, plane = sheet.axes([(0, 0), (1, 0), (2, slice(0, 1))], [2.2, 2.2, 4.4])
    else:
        spots: list[Spot] = [(0, 0), (1, 0), (slice(0, 2), 1)]
        upper, lower, plane = sheet.axes(spots, [2.1, 2.1], ratios=(1.25, 1))
    for axes, name in ((upper, "tip-over margin [m]"), (lower, "required friction [-]")):
        dress_time(axes)
        axes.set_ylabel(name)
    lower.set_xlabel("t [s]")
    for index, (label, run) in enumerate(runs.items()):
        style = line_style(index, len(runs)) | {"label": label}
        margin = tip_over_margin(run, footprint)
        draw_line(upper, run.t, margin, **style)
        draw_line(lower, run.t, required_friction(run), **style)
        is_lifted = np.isneginf(margin)
        hatching: Style = {"facecolor": "none", "edgecolor": colour(index), "hatch": "///", "alpha": 0.5}
        shade_steps((upper, lower), run.t, is_lifted, **hatching)
        if is_lifted.any():
            sheet.write_above(upper, "hatched: the ground does not carry the robot", 0.95)
    span = [float(f([f(run.t) for run in runs.values()])) for f in (np.min, np.max)]
    if span[0] < span[1]:
        lower.set_xlim(*span)
    if upper.dataLim.y0 <= 0:
        upper.axhline(0, **_LIMIT_STYLE | {"color": _OUTLINE_STYLE["edgecolor"]})
    lower.set_ylim(bottom=min(0.0, lower.get_ylim()[0]))
    _draw_footprint(sheet, plane, runs, footprint)
    return sheet.finish("Balance on the ground", legend_entries(runs))


def _draw_footprint(sheet: Sheet, axes: Axes, runs: dict[str, Rollout], footprint: ArrayLike | None) -> None:
    """Draw the footprint and the zero-moment point in the body frame."""
    dress(axes)
    outlines = [footprint_of(run.plant, footprint) for run in runs.values()]
    for corners in {corners.tobytes(): corners for corners in outlines}.values():
        axes.add_patch(Polygon(corners, closed=True, label="footprint", **_OUTLINE_STYLE))
    for index, run in enumerate(runs.values()):
        point = body_zero_moment_point(run)
        draw_curve(axes, *point.T, **line_style(index, len(runs)))
        first = np.flatnonzero(np.isfinite(point[:, 0]))[:1]
        dot: Style = {"color": colour(index), "markersize": 8, "markeredgecolor": "white", "zorder": 5}
        axes.plot(*point[first].T, "o", **dot)
    axes.autoscale_view()
    axes.margins(0.08)
    axes.set_aspect("equal", adjustable="datalim")
    axes.set(xlabel="forward $x_B$ [m]", ylabel="left $y_B$ [m]")
    sheet.write_above(axes, "zero-moment point in the footprint, dot: first", 0.95)
