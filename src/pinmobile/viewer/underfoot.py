"""What the ground does, drawn on it: contact forces, their friction discs, the instantaneous centre."""

from __future__ import annotations

from typing import Any

import numpy as np

import pinmobile.viewer.shapes as shapes
from pinmobile.arrays import Array
from pinmobile.errors import InvalidArgument, shown
from pinmobile.loop import Rollout
from pinmobile.palette import GRIPS, INK, QUIET, SLIDES
from pinmobile.plant import Contacts
from pinmobile.signals import Signal
from pinmobile.viewer.motion import Channel, along
from pinmobile.viewer.stage import Extent, Overlays, Stage

TRAIL, ABOVE = 2, 40
"""What is painted over what: the grid, trails, the path, words, and what shows through everything."""
_DISCS = 12  # over trails, path and words
_NOTHING = 1e-4  # of a scale: not to be seen
_LARGEST = (
    0.4  # radius of the largest disc, or length of the largest arrow without one, in lengths of the robot
)
_THIN = 0.12  # of a disc: an ellipse that is narrower is drawn so wide
_FAR = 4.0  # radii of the scene, beyond which no centre is drawn
_NO_FORCE = 1e-9  # [N]


def draw_ground(
    stage: Stage,
    run: Rollout,
    times: Array,
    poses: Array,
    extent: Extent,
    overlays: Overlays,
) -> tuple[list[Channel], list[list[object]]]:
    """Draw what the ground does, and return its channels and what the legend tells of it.

    Raises
    ------
    InvalidArgument
        If the plant does not tell its contacts.
    """
    found = _contacts(run, times, poses)
    channels: list[Channel] = []
    legend: list[list[object]] = []
    if overlays.contacts:
        _draw_contacts(stage, found, extent, channels, legend)
    if overlays.centre:
        _draw_centre(stage, found.centre, poses, extent, channels, legend)
    return channels, legend


def _contacts(run: Rollout, times: Array, poses: Array) -> Contacts:
    """Return the contacts of the sample before each frame, at the places of the frame."""
    plant: Any = run.plant
    if not callable(getattr(plant, "contacts", None)):
        raise InvalidArgument(
            f"overlays has contacts or centre, of which the plant {shown(plant)} tells nothing, expected a "
            "plant with contacts(q, v, a, u, signals), such as a WheeledRobot"
        )
    now = times + 1e-9 * max(abs(times[-1]), 1.0)
    held = np.clip(np.searchsorted(run.t, now, side="right") - 1, 0, len(run) - 1)
    signals = {name: Signal(unit, values[held]) for name, (unit, values) in run.signals.items()}
    found: Contacts = plant.contacts(run.q[held], run.v[held], run.a[held], run.u[held], signals)
    at = run.poses[held]
    turn = poses[:, 2] - at[:, 2]
    c, s = np.cos(turn)[:, None], np.sin(turn)[:, None]
    away = found.places - at[:, None, :2]
    moved = np.stack([c * away[..., 0] - s * away[..., 1], s * away[..., 0] + c * away[..., 1]], axis=-1)
    return found._replace(places=poses[:, None, :2] + moved, directions=found.directions + turn[:, None])


def _draw_contacts(
    stage: Stage, found: Contacts, extent: Extent, channels: list[Channel], legend: list[list[object]]
) -> None:
    sizes = np.linalg.norm(found.forces, axis=-1)
    limits = np.nan_to_num(found.limits)
    largest = max(float(limits.max(initial=0.0)), 0.0) or float(sizes.max(initial=0.0))
    if not largest > _NO_FORCE:
        return
    scale = _LARGEST * extent.unit / largest
    shared = np.logical_not(np.asarray(found.determined.all(axis=1)))
    paints = {GRIPS: "force of the ground", SLIDES: "slides", QUIET: "force, share of a sum"}
    used = dict.fromkeys(paints, False)
    for k in range(len(found.names)):
        place, turned = found.places[:, k], found.directions[:, k]
        ahead = turned + np.arctan2(found.forces[:, k, 1], found.forces[:, k, 0])
        reach = scale * limits[:, k]
        wide = np.maximum(reach, _THIN * reach.max(axis=1, keepdims=True))
        slides = found.slides[:, k]
        still = QUIET if shared[k] else GRIPS
        for name, paint, shows in (("grips", still, ~slides), ("slides", SLIDES, slides)):
            if not shows.any():
                continue
            used[paint] = True
            path = f"meshcat/contacts/{k}/{name}"
            for part, shape in _disc(GRIPS if name == "grips" else SLIDES).items():
                stage.put(f"{path}/{part}", shape)
                channels += along(f"{path}/{part}", np.column_stack([place, turned]))
                size = np.column_stack([wide, np.ones(len(wide))])
                channels.append(Channel(f"{path}/{part}", "scale", np.where(shows[:, None], size, _NOTHING)))
            stage.put(f"{path}/force", shapes.over(shapes.arrow(0.09), paint, order=ABOVE - 6))
            channels += along(
                f"{path}/force", np.column_stack([place, np.unwrap(ahead)]), 0.012 * extent.unit
            )
            long = np.where(shows, np.maximum(scale * sizes[:, k], _NOTHING), _NOTHING)
            thick = np.where(shows, np.clip(long / (0.05 * extent.unit), _NOTHING, 1.0), _NOTHING)
            thick *= _LARGEST * extent.unit
            channels.append(Channel(f"{path}/force", "scale", np.column_stack([long, thick, thick])))
    told = [(label, paint) for paint, label in paints.items() if used[paint]]
    for k, (label, paint) in enumerate(told):
        legend.append([f"{label}, 1 m = {1 / scale:.2g} N" if k == 0 else label, paint, "", 0.0])
    if np.isfinite(found.limits).any():
        legend.append(["disc: friction it has, mu N", GRIPS, "", 0.3])


def _disc(paint: str) -> dict[str, shapes.Shape]:
    return {
        "disc": shapes.flat(shapes.disc(), paint, order=_DISCS, opacity=0.22),
        "rim": shapes.flat(shapes.disc(0.95), paint, order=_DISCS + 1, opacity=0.9),
    }


def _draw_centre(
    stage: Stage,
    centre: Array,
    poses: Array,
    extent: Extent,
    channels: list[Channel],
    legend: list[list[object]],
) -> None:
    with np.errstate(invalid="ignore"):
        away = np.where(np.isfinite(centre), centre - poses[:, :2], 0.0)
        far = np.hypot(*np.where(np.isfinite(centre), centre - extent.centre, np.inf).T)
    near = far < _FAR * extent.radius
    place = np.where(near[:, None], np.where(np.isfinite(centre), centre, 0.0), poses[:, :2])
    path, unit = "meshcat/centre", extent.unit
    length = np.where(near, np.maximum(np.hypot(*away.T), _NOTHING), _NOTHING)
    angle = np.unwrap(np.arctan2(away[:, 1], away[:, 0]))
    band = shapes.ribbon(np.array([[0.0, 0.0], [1.0, 0.0]]), 0.02 * unit)
    stage.put(f"{path}/way", shapes.flat(band, INK, order=_DISCS + 2, opacity=0.6))
    channels += along(f"{path}/way", np.column_stack([poses[:, :2], angle]))
    shown_at = np.where(near[:, None], [1.0, 1.0, 1.0], _NOTHING)
    channels.append(Channel(f"{path}/way", "scale", np.column_stack([length, shown_at[:, 1:]])))
    ring = shapes.disc(0.6)
    stage.put(f"{path}/point", shapes.flat((0.1 * unit * ring[0], ring[1]), INK, order=_DISCS + 3))
    stage.put(f"{path}/name", shapes.word("ICR", INK, 0.3 * unit, lying=False, order=ABOVE + 5))
    ground = np.zeros(len(place))
    for name, aside in (("point", np.zeros(3)), ("name", unit * np.array([0.25, 0.25, 0.0]))):
        channels.append(Channel(f"{path}/{name}", "position", np.column_stack([place, ground]) + aside))
        channels.append(Channel(f"{path}/{name}", "scale", shown_at))
    legend.append(["way to the instantaneous centre of rotation", INK, "", 0.6])
