"""How a robot stands: where the ground is, what touches it, and the polygon of that."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np
import pinocchio as pin

from pinmobile.arrays import Array, ArrayLike, finite, frozen, lengths, positive
from pinmobile.errors import InvalidArgument, shown
from pinmobile.robot.geometry import Shape
from pinmobile.robot.tree import children, turns_freely
from pinmobile.robot.visuals import VisualFile

WEIGHTLESS = 1e-9
"""Share of the weight: a vertical force of the ground that only rounding made."""

_FLAT = 1e-12  # of the area of a square about the footprint: what rounding leaves of a straight corner


def rectangle(length: float, width: float) -> Array:
    """Return the corners of a rectangle about the origin, shape (4, 2) [m], counter-clockwise."""
    return 0.5 * np.array([[-length, -width], [length, -width], [length, width], [-length, width]])


def checked_footprint(footprint: ArrayLike) -> Array:
    """Return the corners of a convex polygon, counter-clockwise, shape (k, 2).

    Parameters
    ----------
    footprint : array_like, shape (k, 2)
        Its corners in order, either way round, in the body's frame [m]; the last is not the first again.

    Raises
    ------
    InvalidArgument
        If it has fewer than three corners, is not finite, has no area, or is not convex.
    """
    corners = finite("footprint", footprint)
    if corners.ndim != 2 or corners.shape[1] != 2 or len(corners) < 3:
        raise InvalidArgument(f"footprint has shape {corners.shape}, expected (k, 2) with k >= 3 corners")
    edges = np.roll(corners, -1, axis=0) - corners
    scale = float(np.ptp(corners, axis=0).max()) ** 2
    area = 0.5 * float(_cross(corners - corners[0], edges).sum())
    if abs(area) <= _FLAT * scale:
        raise InvalidArgument(f"footprint has an area of {abs(area):.3g} m^2, expected a polygon with > 0")
    if area < 0:
        corners = corners[::-1]
        edges = np.roll(corners, -1, axis=0) - corners
    lengths = np.hypot(*edges.T)
    if not lengths.all():
        k = int(np.argmin(lengths))
        raise InvalidArgument(f"footprint has the corner {corners[k].tolist()} twice in a row, expected once")
    turns = _cross(edges, np.roll(edges, -1, axis=0))
    # A star turns left at each corner too, but more than once round.
    angles = np.arctan2(turns, (edges * np.roll(edges, -1, axis=0)).sum(axis=1))
    if (turns < -_FLAT * scale).any() or angles.sum() > 3 * np.pi:
        k = (int(np.argmin(turns)) + 1) % len(corners)
        raise InvalidArgument(
            f"footprint is not convex at the corner {corners[k].tolist()}, expected a convex polygon"
        )
    return np.asarray(corners)


def hull(points: ArrayLike) -> Array | None:
    """Return the corners of the convex hull of points, counter-clockwise from the one with the least x.

    Parameters
    ----------
    points : array_like, shape (n, 2)
        In any order.

    Returns
    -------
    corners : ndarray, shape (k, 2), or None
        Without those on a straight edge; None where the hull has no area. By Andrew's monotone chain.
    """
    given = np.reshape(np.asarray(points, np.float64), (-1, 2))
    if len(given) < 3:
        return None
    flat = _FLAT * float(np.ptp(given, axis=0).max()) ** 2
    x, y = given.round(9).T  # what differs by rounding alone has no order
    ordered = given[np.lexsort((y, x))]
    halves: list[Array] = []
    for way in (ordered, ordered[::-1]):
        kept: list[Array] = []
        for point in way:
            while len(kept) > 1 and _cross(kept[-1] - kept[-2], point - kept[-1]) <= flat:
                kept.pop()
            kept.append(point)
        halves += kept[:-1]
    return np.array(halves) if len(halves) > 2 else None


def margin_inside(corners: Array, points: Any) -> Any:
    """Return the signed distance of points from the edge of a polygon, positive inside, shape (...) [m].

    Parameters
    ----------
    corners : ndarray, shape (k, 2)
        As `checked_footprint` returns them.
    points : ndarray, shape (..., 2)
        In the same frame [m].
    """
    edges = np.roll(corners, -1, axis=0) - corners  # (k, 2)
    shares = edges / np.square(edges).sum(axis=-1, keepdims=True)
    from_corner = points[..., None, :] - corners  # (..., k, 2)
    along = np.clip((from_corner * shares).sum(axis=-1), 0.0, 1.0)
    square = np.square(from_corner - along[..., None] * edges).sum(axis=-1)
    distance = np.sqrt(np.min(square, axis=-1))
    inside = np.all(_cross(edges, from_corner) >= 0, axis=-1)
    return np.where(inside, distance, -distance)


def pressed_at(wrench: Any, carried: Any) -> Any:
    """Return the point of the ground about which its wrench has no level moment, shape (..., 2) [m].

    Parameters
    ----------
    wrench : ndarray, shape (..., 6)
        Of the ground on the body, along and about the axes of its frame, whose origin lies on the ground.
    carried : ndarray of bool, shape (...)
        Whether the ground carries the body; NaN where it does not.
    """
    vertical = np.where(carried, wrench[..., 2], np.nan)
    return np.stack([-wrench[..., 4] / vertical, wrench[..., 3] / vertical], axis=-1)


def _cross(a: Any, b: Any) -> Any:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


_TOUCH = 0.005  # [m]: what is so near the ground stands on it
_ROUNDING = 1e-9  # [m]
_LEVEL = 0.1  # sine of the angle by which an axle may be off level: files have angles such as 1.57
_FOOTPRINT = "base_footprint"  # REP-120: the link that is on the ground, whatever namespace is before it


@dataclass(frozen=True, eq=False)
class Stance:
    """How a body stands on the ground, in its frame B.

    Parameters
    ----------
    footprint : array_like, shape (k, 2), optional
        Corners of the convex polygon on which it stands [m]; None where it is not known.
    top : float, optional
        Height of its highest point above the ground [m]; None where it is not known.
    grounded : bool
        Whether B's origin is known to lie on the ground; without that, `top` is not known either.

    Raises
    ------
    InvalidArgument
        If the footprint is no convex polygon, the top is not above the ground, or `grounded` is no bool.
    """

    footprint: Array | None = None
    top: float | None = None
    grounded: bool = True

    def __post_init__(self) -> None:
        if not isinstance(self.grounded, bool):
            raise InvalidArgument(f"grounded is {shown(self.grounded)}, expected True or False")
        if self.footprint is not None:
            object.__setattr__(self, "footprint", frozen(checked_footprint(self.footprint)))
        if self.top is not None:
            object.__setattr__(self, "top", positive("top", self.top, "m"))

    @classmethod
    def of_box(cls, size: ArrayLike) -> Stance:
        """Return that of a box that stands about B's origin.

        Parameters
        ----------
        size : array_like, shape (3,)
            Length, width and height, each above zero [m].

        Raises
        ------
        InvalidArgument
            If they are something else.
        """
        length, width, height = lengths(size).tolist()
        return cls(rectangle(length, width), height)

    def _key(self) -> tuple[object, ...]:
        """Return what makes two of them the same one."""
        corners = None if self.footprint is None else self.footprint.tobytes()
        return corners, self.top, self.grounded

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Stance) and self._key() == other._key()

    def __hash__(self) -> int:
        return hash(self._key())

    def written(self) -> dict[str, str]:
        """Return it as attributes of the element <pinmobile> of a URDF, which `stance_written` reads."""
        words = {"ground": "0"} if self.grounded else {}
        if self.footprint is not None:
            words["footprint"] = " ".join(map(repr, self.footprint.ravel().tolist()))
        return words if self.top is None else {**words, "top": repr(self.top)}


@dataclass(frozen=True)
class WheelReading:
    """A wheel, as a model has it at rest.

    Parameters
    ----------
    name : str
        Of the joint that is its axle.
    joint : int
        Number of that joint.
    centre : tuple of 3 floats
        Of the wheel, in the frame of the root link [m].
    axis : tuple of 3 floats
        Unit vector of the axle there, level, in the sense that the joint turns.
    radius : float or None
        None where the model does not tell [m].
    """

    name: str
    joint: int
    centre: tuple[float, float, float]
    axis: tuple[float, float, float]
    radius: float | None


def wheels_of(
    model: pin.Model, data: pin.Data, base: pin.SE3, root: int, shapes: Sequence[Shape]
) -> list[WheelReading]:
    """Return the wheels: on each way from the root, the first joint that turns freely about a level axis.

    Of what is beyond, such as the rollers of an omni wheel, nothing is a wheel of its own.

    Parameters
    ----------
    model, data
        With all joints at rest, Jacobians computed.
    base : pin.SE3
        Pose of the root link.
    root : int
        Its joint.
    shapes : sequence of Shape
        Of the model's links; a cylinder about the axle, or a sphere on it, tells the radius.
    """
    below, wheels = children(model), []
    waiting = below[root][::-1]
    while waiting:
        joint = waiting.pop()
        axis = _axle(model, data, base, joint)
        if axis is None:
            waiting += below[joint][::-1]
            continue
        place = base.inverse() * data.oMi[joint]
        round_about = []
        for shape in shapes:
            if shape.joint == joint:
                at = place * shape.placement
                radius = shape.radius_about(at.rotation.T @ axis)
                aside = np.cross(at.translation - place.translation, axis)
                if radius is not None and np.linalg.norm(aside) <= _TOUCH:
                    round_about.append((radius, at.translation))
        radius, centre = max(round_about, key=lambda pair: pair[0], default=(None, place.translation))
        x, y, z = (float(number) for number in centre)
        across, left, _ = (float(number) for number in axis)
        wheels.append(WheelReading(str(model.names[joint]), joint, (x, y, z), (across, left, 0.0), radius))
    return wheels


def _axle(model: pin.Model, data: pin.Data, base: pin.SE3, joint: int) -> Array | None:
    """Return the axis of a joint that turns freely about a level one, snapped to level."""
    if not turns_freely(model, joint):
        return None
    # Of a model with one joint Pinocchio returns it without the second axis.
    jacobian = pin.getJointJacobian(model, data, joint, pin.WORLD).reshape(6, -1)
    axis = np.asarray(base.rotation.T @ jacobian[3:, model.idx_vs[joint]])
    if abs(axis[2]) > _LEVEL:
        return None
    return np.append(axis[:2] / np.hypot(axis[0], axis[1]), 0.0)


def ground_below(
    model: pin.Model,
    data: pin.Data,
    base: pin.SE3,
    root: int,
    wheels: Sequence[WheelReading],
    given: ArrayLike | None,
    name: str,
) -> tuple[float | None, str]:
    """Return the height of the ground in the frame of the root link, None where nothing tells, and what does.

    Raises
    ------
    InvalidArgument
        If what is given is no number, or the wheels do not stand on one plane.
    """
    if given is not None:
        ground = finite("ground", given)
        if ground.ndim:
            raise InvalidArgument(f"ground has shape {ground.shape}, expected one number: z of the ground")
        return float(ground), "as given"
    lowest = {wheel.name: wheel.centre[2] - wheel.radius for wheel in wheels if wheel.radius is not None}
    if lowest:
        heights = list(lowest.values())
        if max(heights) - min(heights) > _TOUCH:
            listed = ", ".join(f"{wheel} at z = {_rounded(z):.4g}" for wheel, z in lowest.items())
            raise InvalidArgument(
                f"{name}: its wheels do not stand on one plane, their lowest points being {listed} m, "
                f"expected them within {1e3 * _TOUCH:g} mm, or ground=, the z of the ground in the root "
                "link's frame [m]"
            )
        return _rounded(sum(heights) / len(heights)), "below its wheels by their radii"
    for number, frame in enumerate(model.frames):
        is_link = number and frame.type == pin.FrameType.BODY and frame.parentJoint == root
        if is_link and frame.name.endswith(_FOOTPRINT):
            at = base.inverse() * data.oMi[root] * frame.placement
            return _rounded(float(at.translation[2])), f"at its link {frame.name}"
    return (0.0, "the plane of its chain") if root == 3 else (None, "")


def _rounded(height: float) -> float:
    return 0.0 if abs(height) < _ROUNDING else height


def stance_on(
    model: pin.Model,
    data: pin.Data,
    base: pin.SE3,
    wheels: Sequence[WheelReading],
    shapes: Sequence[Shape],
    ground: float,
    *,
    file: VisualFile | None,
    root: int,
) -> tuple[Stance, list[str], list[tuple[float, float]]]:
    """Return how a robot stands on the ground, where that is from, in words, and what stands beside wheels.

    Parameters
    ----------
    model, data, base, wheels, shapes, root
        As in `wheels_of`; `base` is B, on the ground.
    ground : float
        Its height in the frame in which the wheels are [m].
    file : VisualFile or None
        Tells where meshes lie.
    """
    apart = {joint for wheel in wheels for joint in model.subtrees[wheel.joint]}
    placed = [(shape, _place(data, base, shape)) for shape in shapes if shape.joint not in apart]
    heights = [wheel.centre[2] - ground for wheel in wheels]
    # Where a file tells no radius at all, wheels with axles of one height stand on the ground.
    level = bool(heights) and min(heights) > 0 and max(heights) - min(heights) <= _TOUCH
    untold = level and all(wheel.radius is None for wheel in wheels)
    points, names, supports = [], [], list[tuple[float, float]]()
    for wheel, height in zip(wheels, heights, strict=True):
        if untold if wheel.radius is None else abs(height - wheel.radius) <= _TOUCH:
            points.append(np.array([wheel.centre[:2]]))
            names.append(wheel.name)
    for shape, pose in placed:
        if not shape.mesh and abs(pose.translation[2] - shape.reach(pose.rotation)) <= _TOUCH:
            face = None if wheels else shape.corners_below(pose)
            # A caster or a skid of a robot on wheels carries at its middle.
            points.append(np.array([pose.translation[:2]]) if face is None else face)
            names.append(shape.link)
            supports += [(float(x), float(y)) for x, y in points[-1]]
    corners = hull(np.concatenate(points)) if points else None
    listed = ", ".join(dict.fromkeys(names)) or "of all shapes none"
    words = f"what touches the ground, {listed}"
    # A wheel of which nothing is told may stand on the ground too: that changes nothing inside the others.
    lost = [] if untold else [wheel for wheel in wheels if wheel.radius is None and wheel.centre[2] > ground]
    if corners is None:
        words = f"footprint not known: {words}, has no area"
    elif any(margin_inside(corners, np.array(wheel.centre[:2])) < -_TOUCH for wheel in lost):
        corners, radii = None, ", ".join(wheel.name for wheel in lost)
        words = f"footprint not known: {words}, but the file does not tell the radius of {radii}"
    else:
        words = f"footprint: {words}"
    top, why = _top([(shape, pose) for shape, pose in placed if shape.joint == root], file)
    return Stance(corners, top), [words, why], supports


def _place(data: pin.Data, base: pin.SE3, shape: Shape) -> pin.SE3:
    if data.oMi[shape.joint] == base:  # to the last digit, then
        return shape.placement
    return base.inverse() * data.oMi[shape.joint] * shape.placement


def _top(body: Sequence[tuple[Shape, pin.SE3]], file: VisualFile | None) -> tuple[float | None, str]:
    """Return the height of the highest geometry of the body, and where that is from."""
    # What is drawn stands for collision geometry where there is none but that of casters.
    solid = [pair for pair in body if pair[0].collides]
    chosen = solid if any(_is_above(*pair) for pair in solid) else body
    heights = [(shape, shape.highest(pose, file) if file else None) for shape, pose in chosen]
    lost = [shape.mesh for shape, z in heights if z is None]
    known = [(z, shape.link) for shape, z in heights if z is not None]
    if lost or not known or max(known)[0] <= 0:
        reason = f"cannot be read: {', '.join(dict.fromkeys(lost))}" if lost else "there is no geometry"
        return None, f"top not known: {reason}"
    top, link = max(known)
    return top, f"top {top:.4g} m, that of {link}"


def _is_above(shape: Shape, pose: pin.SE3) -> bool:
    """Tell whether a shape is more than what a caster is: not a primitive that touches the ground."""
    return bool(shape.mesh) or pose.translation[2] - shape.reach(pose.rotation) > _TOUCH


def stance_written(root: Element, name: str) -> Stance | None:
    """Return what a file of our own says in its element <pinmobile>, or None where there is none.

    Raises
    ------
    InvalidArgument
        If it says what cannot be.
    """
    element = root.find("pinmobile")
    if element is None:
        return None
    words = {key: element.get(key, "").split() for key in ("footprint", "top")}
    try:
        numbers = {key: list(map(float, given)) for key, given in words.items()}
    except ValueError:
        raise InvalidArgument(f"{name}: <pinmobile> has {element.attrib}, expected numbers") from None
    footprint, top = numbers["footprint"], numbers["top"]
    if len(footprint) % 2 or len(top) > 1:
        raise InvalidArgument(f"{name}: <pinmobile> has {element.attrib}, expected x y of corners, and a top")
    return Stance(
        np.reshape(footprint, (-1, 2)) if footprint else None,
        top[0] if top else None,
        element.get("ground") is not None,
    )
