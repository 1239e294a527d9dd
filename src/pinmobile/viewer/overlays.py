"""What is shown beside the robot, and from where one looks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple, TypeAlias

from pinmobile.arrays import Array, ArrayLike, finite, frozen, positive, sequence
from pinmobile.dh import DHTable
from pinmobile.errors import InvalidArgument, shown
from pinmobile.simulation import Rollout

_BASE_FORCES = ("Fx", "Fy", "Mz")

Rollouts: TypeAlias = Rollout | Mapping[str, Rollout]


class View(NamedTuple):
    """From where one looks, at what, both shape (3,) [m]."""

    eye: Array
    target: Array


@dataclass(frozen=True)
class Stay:
    """A camera that stays; by default where it sees all of the paths.

    Parameters
    ----------
    eye, target : array_like, shape (3,), optional
        From where to look at what [m].
    """

    eye: ArrayLike | None = None
    target: ArrayLike | None = None

    def __post_init__(self) -> None:
        for name in ("eye", "target"):
            value = getattr(self, name)
            if value is not None:
                point = finite(name, value)
                if point.shape != (3,):
                    raise InvalidArgument(f"{name} has shape {point.shape}, expected (3,)")
                object.__setattr__(self, name, frozen(point))


@dataclass(frozen=True)
class Follow:
    """A camera that moves along with the robot, without turning.

    Parameters
    ----------
    distance : float
        From the robot [m].
    """

    distance: float = 4.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "distance", positive("distance", self.distance, "m"))


@dataclass(frozen=True)
class Arrows:
    """Force on the base as an arrow and moment as an arc, to scale; those of arms are not drawn.

    They are the inputs Fx, Fy and Mz of the plant: one that has others is refused.

    Parameters
    ----------
    force : float, optional
        Length of the arrow [m/N]; by default such that the largest is 1.6 times as long as the robot.
    moment : float, optional
        Radius of the arc [m/(N m)]; by default such that the largest is 0.8 times as long as the robot.
    """

    force: float | None = None
    moment: float | None = None

    def __post_init__(self) -> None:
        for name, unit in (("force", "m/N"), ("moment", "m/(N m)")):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, positive(name, getattr(self, name), unit))


@dataclass(frozen=True)
class Overlays:
    """What is shown beside the robot.

    Parameters
    ----------
    grid : bool
        A floor grid with a scale.
    path : bool
        The reference path, dashed.
    trail : bool
        The path travelled so far.
    caption : bool
        Time and position error.
    desired : bool
        The desired pose, as a ghost.
    body_frame : bool
        The axes x_B, y_B and z_B.
    frames : sequence of DHTable
        Tables whose frames, the ground's included, are drawn as triads with their names.
    arrows : Arrows, optional
        Force and moment.
    camera : Stay or Follow
        From where one looks.
    """

    grid: bool = True
    path: bool = True
    trail: bool = True
    caption: bool = True
    desired: bool = False
    body_frame: bool = False
    frames: Sequence[DHTable] = ()
    arrows: Arrows | None = None
    camera: Stay | Follow = field(default_factory=Stay)

    def __post_init__(self) -> None:
        object.__setattr__(self, "frames", sequence("frames", self.frames, "a sequence of DHTable"))
        for table in self.frames:
            if not isinstance(table, DHTable) or table.variables != ("y", "x", "psi"):
                raise InvalidArgument(f"frames has {shown(table)}, expected tables with variables y, x, psi")
        for name, kind in (("arrows", Arrows | None), ("camera", Stay | Follow)):
            if not isinstance(getattr(self, name), kind):
                raise InvalidArgument(f"{name} is {shown(getattr(self, name))}, expected {kind}")


def pushing(run: Rollout) -> list[int]:
    """Return which of the inputs are the force and the moment on the base.

    Raises
    ------
    InvalidArgument
        If the plant has no such inputs.
    """
    names = [one.name for one in run.inputs]
    missing = [name for name in _BASE_FORCES if name not in names]
    if missing:
        raise InvalidArgument(
            f"overlays has arrows, of the inputs {', '.join(_BASE_FORCES)}, and the plant's inputs are "
            f"{', '.join(names)}: leave arrows out"
        )
    return [names.index(name) for name in _BASE_FORCES]


def checked_overlays(overlays: Overlays | None, default: Overlays) -> Overlays:
    """Return the overlays that are asked for.

    Raises
    ------
    InvalidArgument
        If they are something else.
    """
    if overlays is None:
        return default
    if not isinstance(overlays, Overlays):
        raise InvalidArgument(f"overlays is a {type(overlays).__name__}, expected Overlays")
    return overlays


def checked_runs(rollouts: Any) -> dict[str, Rollout]:
    """Return the rollouts by label; a single one has the label "".

    Raises
    ------
    InvalidArgument
        If it is something else, holds nothing, or the plant of one does not tell where its body is.
    """
    runs = {"": rollouts} if isinstance(rollouts, Rollout) else rollouts
    if not isinstance(runs, Mapping) or not runs:
        raise InvalidArgument(
            f"rollout is {shown(rollouts)}, expected a Rollout or a mapping of labels to them"
        )
    for label, run in runs.items():
        where = f"rollout[{label!r}]" if label else "rollout"
        if not isinstance(run, Rollout):
            raise InvalidArgument(f"{where} is a {type(run).__name__}, expected a Rollout")
        try:
            _ = run.poses, run.reference_poses
        except InvalidArgument as error:
            raise InvalidArgument(f"{where}.{error}") from None
    return dict(runs)
