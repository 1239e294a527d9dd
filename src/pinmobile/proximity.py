"""Distances between a robot's links, and between its links and the ground: `clearance`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
import pinocchio as pin

from pinmobile.arrays import Array, ArrayLike, frozen
from pinmobile.errors import InvalidArgument, format_value
from pinmobile.robot import Solid, Solids

GROUND = "ground"
"""Name of the ground in pairs of links."""

_TOUCH_TOLERANCE = 1e-6  # [m]: largest distance that counts as contact
_TOLERANCE, _DEPTH_TOLERANCE = 1e-10, 1e-8  # [m]: tolerances of the distance and of the penetration depth
_ITERATIONS, _DEPTH_ITERATIONS = 1000, 255
_GUESS = np.array([1.0, 0.0, 0.0]), np.zeros(2, np.int32)  # default initial guess of coal
_MIN_DEPTH = -1e6  # [m]: coal returns less if its depth computation fails
_GRID = 25  # grid values of each joint in the search for a contact of two links
_REFINEMENTS = 4  # refinements of this search, each half as wide
_MAX_JOINTS = 2  # largest number of joints between two links of this search
_RIGID_REASON = "at a constant distance"
_JOINT_REASON = "joined by a joint"
_REST_REASON = "touch at rest"
_APART_REASON = "never touch in any position of the joints between them"
_GROUND_REASON = "stands on the ground"

_NO_PAIRS = (
    "no pairs, since no part of the robot moves relative to another part or the ground: expected a robot "
    "with an arm, see robot.mount(...), whose URDF has <collision> shapes"
)
_STARTS = 5  # start points of the search for a contact of two links
_WINDING_LIMIT = 0.5

Pair = tuple[str, str]
_Numbers = tuple[int, int]


@dataclass(frozen=True, eq=False, repr=False)
class Clearance:
    """Distances between a robot's links, and between its links and the ground, at one or many configurations.

    Attributes
    ----------
    distances : ndarray, shape (..., pairs)
        Distance of each pair [m]. A negative value is the penetration depth.
    pairs : tuple of (str, str)
        Names of two links, or of a link and ``"ground"``, for each column of `distances`.
    left_out : mapping of (str, str) to str
        Pairs that do not count, and the reason.

    See Also
    --------
    clearance : function that returns this object
    MobileRobot.solids : collision geometry

    Examples
    --------
    >>> from pinmobile.proximity import Clearance
    >>> pairs = (("arm/hand", "ground"), ("arm/hand", "base_link"))
    >>> found = Clearance([[0.3, 0.2], [0.05, 0.2]], pairs, {})
    >>> found.smallest, found.nearest, found.at  # [m]
    (0.05, ('arm/hand', 'ground'), (1,))
    """

    distances: Array
    pairs: tuple[Pair, ...]
    left_out: Mapping[Pair, str]

    def __post_init__(self) -> None:
        object.__setattr__(self, "distances", frozen(self.distances))

    @cached_property
    def distance(self) -> Array:
        """Distance of the nearest pair at each configuration, shape (...) [m]; infinite if no pair counts."""
        return frozen(self.distances.min(axis=-1, initial=np.inf))

    @property
    def smallest(self) -> float:
        """Smallest of all distances [m]; infinite if there is none."""
        return float(self.distance.min(initial=np.inf))

    @property
    def at(self) -> tuple[int, ...]:
        """Index of the configuration with the smallest distance."""
        return tuple(int(k) for k in np.unravel_index(self.distance.argmin(), self.distance.shape))

    @property
    def nearest(self) -> Pair:
        """Pair of links with the smallest distance.

        Raises
        ------
        InvalidArgument
            If no pair counts.
        """
        if not self.pairs:
            raise InvalidArgument(f"clearance has {_NO_PAIRS}")
        return self.pairs[int(self.distances[self.at].argmin())]

    def __repr__(self) -> str:
        return f"<Clearance: {self.summary}>"

    @property
    def summary(self) -> str:
        """Smallest distance and its pair, as text."""
        if not self.distances.size:
            return _NO_PAIRS if not self.pairs else "no configurations"
        return f"{self.smallest:.4g} m between {' and '.join(self.nearest)}"

    def __str__(self) -> str:
        count = len(self.pairs)
        lines = [f"smallest clearance {self.summary}; {count} pairs" if count else self.summary]
        reasons = dict.fromkeys(self.left_out.values())
        for reason in reasons:
            pairs = [" - ".join(pair) for pair, text in self.left_out.items() if text == reason]
            lines.append(f"left out, {reason}: " + ("" if reason != _RIGID_REASON else f"{len(pairs)} pairs"))
            lines[-1] += ", ".join(pairs) if reason != _RIGID_REASON else ""
        return "\n".join(lines)


def clearance(robot: Any, q: ArrayLike) -> Clearance:
    """Return the distances between a robot's links, and between its links and the ground.

    The library coal computes them for the collision shapes of body and arms and the boxes of loads. Wheels of
    a wheel table are cylinders of a tyre's usual width. For pairs with meshes, each value is at most the
    distance of the meshes: only the nearest pair is computed exactly, for the others the convex hulls replace
    the meshes. The ground is the plane z = 0.

    Four kinds of pairs do not count, and `Clearance.left_out` lists them: pairs at a constant distance; links
    joined by a joint; pairs that touch in the configuration ``robot.rest``; and pairs with one or two joints
    between them that never touch. A search over about 600 positions of these joints, refined near the
    smallest distance, decides which pairs never touch.

    Parameters
    ----------
    robot : MobileRobot or WheeledRobot
        Robot, or another plant with ``solids`` and ``solid_placements(q)``.
    q : array_like, shape (..., nq)
        Configurations [m, m, rad, ...].

    Returns
    -------
    proximity.Clearance
        Distances, shape (..., pairs) [m], and the names of the pairs.

    Raises
    ------
    InvalidArgument
        If `robot` has another type, the body or an arm has no collision shapes, a mesh cannot be read, or `q`
        has another shape or is not finite.

    See Also
    --------
    proximity.Clearance : result of this function
    MobileRobot.mount : put an arm on the robot

    Examples
    --------
    >>> from pinmobile import MobileRobot, clearance
    >>> robot = MobileRobot.box().mount("double_pendulum_simple")
    >>> found = clearance(robot, robot.rest)
    >>> found.smallest  # [m]
    0.075
    >>> [link.split("/")[1] for link in found.nearest]
    ['base_link', 'link2']
    """
    if isinstance(robot, type) or not hasattr(type(robot), "solid_placements"):
        raise InvalidArgument(
            f"robot is {format_value(robot)}, which has no collision geometry, expected a "
            "MobileRobot or a WheeledRobot"
        )
    choice = _choice(robot)
    placements = np.asarray(robot.solid_placements(q))
    distances = choice.scene.distances(placements.reshape(-1, *placements.shape[-3:]), choice.pairs)
    names = tuple(choice.scene.pair_names(pair) for pair in choice.pairs)
    return Clearance(distances.reshape(*placements.shape[:-3], len(names)), names, dict(choice.left_out))


@dataclass(frozen=True, eq=False)
class _Choice:
    """Pairs of links that count, and the reasons against the other pairs."""

    scene: _Scene
    pairs: tuple[_Numbers, ...]
    left_out: Mapping[Pair, str]


def _choice(robot: Any) -> _Choice:
    """Return the pairs of a robot's links that count, from a cache for each collision geometry."""
    solids = robot.solids  # the key, since equal robots may have different shapes
    choice = _choices.get(solids)
    if choice is None:
        choice = _choices[solids] = _choose_pairs(robot)
    return choice


_choices: WeakKeyDictionary[Any, _Choice] = WeakKeyDictionary()


def _choose_pairs(robot: Any) -> _Choice:
    solids: Solids = robot.solids
    scene = _Scene(solids.shapes)
    left_out: dict[Pair, str] = {}
    pairs = []
    for pair in combinations(range(len(scene.links) + 1), 2):
        reason = _exclusion_reason(solids, scene, pair)
        if reason:
            left_out[scene.pair_names(pair)] = reason
        else:
            pairs.append(pair)
    rest = np.asarray(robot.solid_placements(robot.rest))
    for pair in tuple(pairs):
        if scene.exact_distance(rest, pair) <= _TOUCH_TOLERANCE:
            left_out[scene.pair_names(pair)] = _REST_REASON
            pairs.remove(pair)
    for joints, group in _group_by_joints(solids, scene, pairs).items():
        for pair, touches in zip(group, _can_touch(robot, solids, scene, joints, group), strict=True):
            if not touches:
                left_out[scene.pair_names(pair)] = _APART_REASON
    remaining = tuple(pair for pair in pairs if scene.pair_names(pair) not in left_out)
    return _Choice(scene, remaining, left_out)


def _exclusion_reason(solids: Solids, scene: _Scene, pair: _Numbers) -> str:
    """Return the reason why a pair never counts; an empty text if there is none."""
    a, b = (scene.part(k) for k in pair)
    if a == b:
        link = scene.links[pair[0]] if scene.is_ground(pair[1]) else ""
        return _GROUND_REASON if link in solids.standing else _RIGID_REASON
    joints = _joints_between(solids, a, b)
    return _JOINT_REASON if len(joints) == 1 and not scene.is_ground(pair[1]) else ""


def _joints_between(solids: Solids, a: int, b: int) -> tuple[int, ...]:
    """Return the parts whose joints lie between two parts."""
    branches: list[list[int]] = []
    for part in (a, b):
        branch = []
        while part > 0:
            branch.append(part)
            part = solids.parents[part]
        branches.append(branch)
    return tuple(sorted(set(branches[0]) ^ set(branches[1])))


def _group_by_joints(
    solids: Solids, scene: _Scene, pairs: Sequence[_Numbers]
) -> dict[tuple[int, ...], list[_Numbers]]:
    """Return the pairs with at most two joints between them, grouped by these joints."""
    groups: dict[tuple[int, ...], list[_Numbers]] = {}
    for pair in pairs:
        joints = _joints_between(solids, scene.part(pair[0]), scene.part(pair[1]))
        is_simple = all(solids.moves[k].stop - solids.moves[k].start == 1 for k in joints)
        if len(joints) <= _MAX_JOINTS and is_simple:
            groups.setdefault(joints, []).append(pair)
    return groups


def _can_touch(
    robot: Any, solids: Solids, scene: _Scene, joints: tuple[int, ...], pairs: list[_Numbers]
) -> list[bool]:
    """Return for each pair whether it touches in some position of the joints between its links."""
    columns = [solids.moves[k].start for k in joints]
    rest = np.asarray(robot.rest)
    low, high = np.transpose([_joint_range(robot, rest, column) for column in columns])

    def place(values: Array) -> Array:
        """Return the placements at displacements of the joints, shape (n, joints)."""
        displacements = np.zeros((len(values), robot.nv))
        displacements[:, columns] = values
        return np.asarray(robot.solid_placements(robot.integrate(rest, displacements)))

    positions = _lattice([np.linspace(a, b, _GRID) for a, b in zip(low, high, strict=True)])
    width, offsets = (high - low) / (_GRID - 1), _lattice([np.linspace(-1, 1, 5)] * len(columns))
    placements = place(positions)
    bounds = scene.bounds(placements, pairs)
    results = []
    for pair, bound in zip(pairs, bounds.T, strict=True):
        order = np.argsort(bound)
        candidates = [k for k in order if bound[k] <= _TOUCH_TOLERANCE]
        if any(scene.overlaps(placements[k], pair) for k in candidates):
            results.append(True)
            continue
        distances = [scene.exact_distance(placements[k], pair) for k in order[:_STARTS]]
        centre, nearest = positions[order[int(np.argmin(distances))]], min(distances)
        for level in range(_REFINEMENTS):
            points = np.clip(centre + width * 0.5**level * offsets, low, high)
            trials = [scene.exact_distance(each, pair) for each in place(points)]
            centre, nearest = points[int(np.argmin(trials))], min(nearest, *trials)
        results.append(nearest <= _TOUCH_TOLERANCE)
    return results


def _lattice(values: Sequence[Array]) -> Array:
    """Return all combinations of the given values, shape (n, k)."""
    return np.stack(np.meshgrid(*values, indexing="ij"), axis=-1).reshape(-1, len(values))


def _joint_range(robot: Any, rest: Array, column: int) -> tuple[float, float]:
    """Return the range of a joint's displacement from rest; a full turn is the maximum."""
    one = robot.coordinates[column]
    low, high = one.lower - rest[column], one.upper - rest[column]
    limit = np.pi if one.unit == "rad" else 1.0
    if high - low > 2 * limit:
        return -limit, limit
    return float(low), float(high)


class _Scene:
    """Collision shapes in coal, grouped by links, and the ground.

    Parameters
    ----------
    shapes : sequence of Solid
        Collision shapes of the robot.
    """

    def __init__(self, shapes: Sequence[Solid]) -> None:
        import coal

        self.links = tuple(dict.fromkeys(shape.link for shape in shapes))
        self._parts = {shape.link: shape.part for shape in shapes}
        self._shapes_of = [[k for k, shape in enumerate(shapes) if shape.link == link] for link in self.links]
        self._shapes_of.append([len(shapes)])
        plane = coal.Halfspace(np.array([0.0, 0.0, 1.0]), 0.0)
        self._convex = [*(shape.geometry for shape in shapes), plane]
        self._meshes = [*(shape.mesh for shape in shapes), None]
        self.model = pin.GeometryModel()
        for k, geometry in enumerate(self._convex):
            self.model.addGeometryObject(pin.GeometryObject(f"{k}", 0, pin.SE3.Identity(), geometry))

    def is_ground(self, k: int) -> bool:
        """Return whether an index denotes the ground."""
        return k == len(self.links)

    def part(self, k: int) -> int:
        """Return the moving part of a link; the level ground belongs to the body."""
        return 0 if self.is_ground(k) else self._parts[self.links[k]]

    def pair_names(self, pair: _Numbers) -> Pair:
        """Return the names of two links."""
        a, b = (GROUND if self.is_ground(k) else self.links[k] for k in pair)
        return a, b

    def bounds(self, placements: Array, pairs: Sequence[_Numbers]) -> Array:
        """Return lower bounds of the distances of pairs of links, by convex hulls, shape (n, pairs) [m].

        Parameters
        ----------
        placements : ndarray, shape (n, shapes, 4, 4)
            Placements of the shapes.
        pairs : sequence of (int, int)
            Indices of links.
        """
        if not pairs:
            return np.empty((len(placements), 0))
        model, starts = pin.GeometryModel(self.model), []
        for pair in pairs:
            starts.append(len(model.collisionPairs))
            for i, j in self._shapes(pair):
                model.addCollisionPair(pin.CollisionPair(i, j))
        data = model.createData()
        requests, results = list(data.distanceRequests), list(data.distanceResults)
        for request in requests:
            _set_tolerances(request)
        data.oMg[len(self._convex) - 1] = pin.SE3.Identity()
        minima = np.empty((len(placements), len(model.collisionPairs)))
        for row, row_minima in zip(placements, minima, strict=True):
            for k, placement in enumerate(row):
                data.oMg[k] = pin.SE3(placement)
            for request in requests:  # reset the guess: last digits must not depend on earlier calls
                request.cached_gjk_guess, request.cached_support_func_guess = _GUESS
            pin.computeDistances(model, data)
            row_minima[:] = [result.min_distance for result in results]
        for row, k in np.argwhere(minima < _MIN_DEPTH):
            pair = model.collisionPairs[int(k)]
            minima[row, k] = self._hull_distance(pair.first, pair.second, placements[row])
        return np.asarray(np.minimum.reduceat(minima, starts, axis=1))

    def _shapes(self, pair: _Numbers) -> list[_Numbers]:
        return [(i, j) for i in self._shapes_of[pair[0]] for j in self._shapes_of[pair[1]]]

    def has_mesh(self, pair: _Numbers) -> bool:
        """Return whether the distance of two links may exceed the distance of their convex hulls.

        For a hull and the ground, both distances are equal.
        """
        meshes = (self._meshes[k] for one in pair for k in self._shapes_of[one])
        return not self.is_ground(pair[1]) and any(mesh is not None for mesh in meshes)

    def distances(self, placements: Array, pairs: Sequence[_Numbers]) -> Array:
        """Return the distances of pairs, shape (n, pairs) [m], exact for the nearest pair.

        For other pairs with meshes, the value is the lower bound from `bounds`.
        """
        values = self.bounds(placements, pairs)
        meshes = [self.has_mesh(pair) for pair in pairs]
        if not any(meshes):
            return values
        for row, row_values in zip(placements, values, strict=True):
            nearest = np.inf
            for k in np.argsort(row_values):
                if row_values[k] >= nearest:
                    break
                row_values[k] = self.exact_distance(row, pairs[k]) if meshes[k] else row_values[k]
                nearest = min(nearest, row_values[k])
        return values

    def exact_distance(self, placements: Array, pair: _Numbers) -> float:
        """Return the distance of two links [m] for placements of the shapes, shape (shapes, 4, 4).

        If meshes overlap, this is the (negative) distance of their convex hulls.
        """
        return min(self._shape_distance(i, j, placements) for i, j in self._shapes(pair))

    def _shape_distance(self, i: int, j: int, placements: Array) -> float:
        import coal

        hulls = self._hull_distance(i, j, placements)
        if j == len(self._convex) - 1 or (self._meshes[i] is None and self._meshes[j] is None):
            return hulls
        poses = [self._place(k, placements) for k in (i, j)]
        request, result = coal.DistanceRequest(), coal.DistanceResult()
        _set_tolerances(request)
        solid = float(coal.distance(self._solid(i), poses[0], self._solid(j), poses[1], request, result))
        if solid <= _TOUCH_TOLERANCE or (hulls < 0 and self._encloses(i, j, placements)):
            return min(hulls, solid)
        return solid

    def _hull_distance(self, i: int, j: int, placements: Array) -> float:
        """Return the distance of the convex hulls of two shapes [m]."""
        import coal

        hulls = self._convex[i], self._place(i, placements), self._convex[j], self._place(j, placements)
        for tolerance in _DEPTH_TOLERANCE * 10.0 ** np.arange(6):  # coal finds some depths only roughly
            request = coal.DistanceRequest()
            _set_tolerances(request)
            request.epa_tolerance = tolerance
            distance = float(coal.distance(*hulls, request, coal.DistanceResult()))
            if distance > _MIN_DEPTH:
                return distance
        return -_TOUCH_TOLERANCE  # they overlap

    def overlaps(self, placements: Array, pair: _Numbers) -> bool:
        """Return whether two links overlap."""
        import coal

        for i, j in self._shapes(pair):
            poses = [self._place(k, placements) for k in (i, j)]
            request, result = coal.CollisionRequest(), coal.CollisionResult()
            if coal.collide(self._solid(i), poses[0], self._solid(j), poses[1], request, result):
                return True
        return False

    def _solid(self, k: int) -> Any:
        return self._convex[k] if self._meshes[k] is None else self._meshes[k]

    def _place(self, k: int, placements: Array) -> Any:
        import coal

        if k == len(placements):
            return coal.Transform3s()
        return coal.Transform3s(placements[k, :3, :3], placements[k, :3, 3])

    def _encloses(self, i: int, j: int, placements: Array) -> bool:
        """Return whether one of two shapes with disjoint surfaces encloses the other."""
        for outer, inner in ((i, j), (j, i)):
            mesh = self._meshes[outer]
            if mesh is None:
                continue  # a primitive is solid: a shape inside overlaps
            point = _inner_point(self._solid(inner))
            world = placements[inner] @ np.append(point, 1.0)
            position = np.linalg.solve(placements[outer], world)[:3]
            if _winding_number(mesh, position) > _WINDING_LIMIT:
                return True
        return False


def _set_tolerances(request: Any) -> None:
    request.gjk_tolerance, request.gjk_max_iterations = _TOLERANCE, _ITERATIONS
    request.epa_tolerance, request.epa_max_iterations = _DEPTH_TOLERANCE, _DEPTH_ITERATIONS


def _inner_point(geometry: Any) -> Array:
    """Return a point of a shape: a vertex of a mesh, the centre of any other shape."""
    return np.array(geometry.vertices()[0]) if hasattr(geometry, "num_tris") else np.zeros(3)


def _winding_number(mesh: Any, point: Array) -> float:
    """Return the winding number of a mesh: one inside, zero outside (van Oosterom, Strackee, 1983)."""
    triangles = (mesh.tri_indices(k) for k in range(mesh.num_tris))
    faces = np.array([[triangle[0], triangle[1], triangle[2]] for triangle in triangles])
    a, b, c = np.moveaxis((np.asarray(mesh.vertices()) - point)[faces], 1, 0)
    A, B, C = (np.linalg.norm(x, axis=1) for x in (a, b, c))
    ab, bc, ca = (np.einsum("ij,ij->i", *pair) for pair in ((a, b), (b, c), (c, a)))
    spread = A * B * C + ab * C + bc * A + ca * B
    turns = 2 * np.arctan2(np.einsum("ij,ij->i", a, np.cross(b, c)), spread)
    return abs(float(turns.sum())) / (4 * np.pi)
