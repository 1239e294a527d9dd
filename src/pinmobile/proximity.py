"""How far a robot's links are from one another and from the ground: `clearance`."""

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
from pinmobile.errors import InvalidArgument, shown
from pinmobile.robot import Solid, Solids

GROUND = "ground"
"""What the ground is called among links."""

_TOUCH = 1e-6  # [m]: what is so near touches
_EXACT, _DEEP = 1e-10, 1e-8  # [m], of the nearest points, and of how deep shapes overlap
_ITERATIONS, _DEEP_ITERATIONS = 1000, 255
_GUESS = np.array([1.0, 0.0, 0.0]), np.zeros(2, np.int32)  # coal's own: where it begins
_FAILED = -1e6  # [m]: what is beyond says that coal has found no depth
_GRID = 25  # values of each joint between two links that are tried, to see whether they can touch
_FINER = 4  # rounds of search from there, each half as wide
_NEAR = 2  # joints between two links for which that is tried
_RIGID = "nothing moves one against the other"
_JOINED = "joined by a joint"
_AT_REST = "touch at rest"
_APART = "never touch, whatever the joints between them do"
_STANDS = "stands on the ground"

_NO_PAIRS = (
    "no pairs, as nothing of the robot moves against another part of it or the ground: expected an arm, by "
    "robot.mount(...), whose links have shapes, those that a URDF has as <collision>"
)
_STARTS = 5  # of the search for a place where two links touch
_INSIDE = 0.5

Pair = tuple[str, str]
_Numbers = tuple[int, int]


@dataclass(frozen=True, eq=False, repr=False)
class Clearance:
    """How far a robot's links are from one another and from the ground, at many configurations.

    Attributes
    ----------
    distances : ndarray, shape (..., pairs)
        Of each pair [m]; below zero the depth by which they overlap.
    pairs : tuple of (str, str)
        Two links, or a link and ``"ground"``.
    left_out : mapping of (str, str) to str
        Pairs that do not count, and why.
    """

    distances: Array
    pairs: tuple[Pair, ...]
    left_out: Mapping[Pair, str]

    def __post_init__(self) -> None:
        object.__setattr__(self, "distances", frozen(self.distances))

    @cached_property
    def distance(self) -> Array:
        """Of the nearest pair, shape (...) [m]; infinite where no pair counts."""
        return frozen(self.distances.min(axis=-1, initial=np.inf))

    @property
    def smallest(self) -> float:
        """The smallest of all [m]."""
        return float(self.distance.min(initial=np.inf))

    @property
    def at(self) -> tuple[int, ...]:
        """Index of the configuration of the smallest."""
        return tuple(int(k) for k in np.unravel_index(self.distance.argmin(), self.distance.shape))

    @property
    def nearest(self) -> Pair:
        """The pair with the smallest.

        Raises
        ------
        InvalidArgument
            If no pair counts.
        """
        if not self.pairs:
            raise InvalidArgument(f"clearance has {_NO_PAIRS}")
        return self.pairs[int(self.distances[self.at].argmin())]

    def __repr__(self) -> str:
        return f"<Clearance: {self.told}>"

    @property
    def told(self) -> str:
        """The smallest and its pair, as text."""
        if not self.distances.size:
            return _NO_PAIRS if not self.pairs else "of no configuration"
        return f"{self.smallest:.4g} m between {' and '.join(self.nearest)}"

    def __str__(self) -> str:
        lines = [f"smallest clearance {self.told}; {len(self.pairs)} pairs" if self.pairs else self.told]
        reasons = dict.fromkeys(self.left_out.values())
        for reason in reasons:
            pairs = [" - ".join(pair) for pair, why in self.left_out.items() if why == reason]
            lines.append(f"left out, {reason}: " + ("" if reason != _RIGID else f"{len(pairs)} pairs"))
            lines[-1] += ", ".join(pairs) if reason != _RIGID else ""
        return "\n".join(lines)


def clearance(robot: Any, q: ArrayLike) -> Clearance:
    """Return how far a robot's links are from one another and from the ground.

    By coal, from the collision shapes of body and arms, and boxes of loads; wheels of a table are cylinders
    of a tyre's usual width. Meshes count as their convex hulls, so that no distance is too large. The ground
    is the plane z = 0. Left out, and named, are pairs that nothing moves against one another, neighbours that
    a joint joins, pairs that touch at rest, and those with one or two joints between them that never touch in
    any position of these, as far as some six hundred of them and a search from the nearest show.

    Parameters
    ----------
    robot : MobileRobot or WheeledRobot
        Or another plant with ``solids`` and ``solid_placements(q)``.
    q : array_like, shape (..., nq)
        Configurations [m, m, rad, ...].

    Returns
    -------
    clearance : Clearance

    Raises
    ------
    InvalidArgument
        If `robot` is something else, its body or an arm has no collision shapes, a mesh cannot be read, or
        `q` has another shape or is not finite.
    """
    if isinstance(robot, type) or not hasattr(type(robot), "solid_placements"):
        raise InvalidArgument(
            f"robot is {shown(robot)}, which does not tell its collision shapes, expected a MobileRobot or a "
            "WheeledRobot"
        )
    choice = _choice(robot)
    placements = np.asarray(robot.solid_placements(q))
    found = choice.scene.distances(placements.reshape(-1, *placements.shape[-3:]), choice.pairs)
    names = tuple(choice.scene.named(pair) for pair in choice.pairs)
    return Clearance(found.reshape(*placements.shape[:-3], len(names)), names, dict(choice.left_out))


@dataclass(frozen=True, eq=False)
class _Choice:
    """The pairs of links that count, and why others do not."""

    scene: _Scene
    pairs: tuple[_Numbers, ...]
    left_out: Mapping[Pair, str]


def _choice(robot: Any) -> _Choice:
    """Return the pairs of a robot's links that count; what cannot change is chosen once."""
    solids = robot.solids  # not the robot, which equals one of other shapes
    found = _choices.get(solids)
    if found is None:
        found = _choices[solids] = _chosen(robot)
    return found


_choices: WeakKeyDictionary[Any, _Choice] = WeakKeyDictionary()


def _chosen(robot: Any) -> _Choice:
    solids: Solids = robot.solids
    scene = _Scene(solids.shapes)
    left_out: dict[Pair, str] = {}
    pairs = []
    for pair in combinations(range(len(scene.links) + 1), 2):
        reason = _why_not(solids, scene, pair)
        if reason:
            left_out[scene.named(pair)] = reason
        else:
            pairs.append(pair)
    at_rest = np.asarray(robot.solid_placements(robot.rest))
    for pair in tuple(pairs):
        if scene.exact(at_rest, pair) <= _TOUCH:
            left_out[scene.named(pair)] = _AT_REST
            pairs.remove(pair)
    for joints, near in _by_joints(solids, scene, pairs).items():
        for pair, touches in zip(near, _can_touch(robot, solids, scene, joints, near), strict=True):
            if not touches:
                left_out[scene.named(pair)] = _APART
    counted = tuple(pair for pair in pairs if scene.named(pair) not in left_out)
    return _Choice(scene, counted, left_out)


def _why_not(solids: Solids, scene: _Scene, pair: _Numbers) -> str:
    """Return why a pair does not count, whatever its distance; nothing if it does."""
    a, b = (scene.part(k) for k in pair)
    if a == b:
        link = scene.links[pair[0]] if scene.is_ground(pair[1]) else ""
        return _STANDS if link in solids.standing else _RIGID
    between = _between(solids, a, b)
    return _JOINED if len(between) == 1 and not scene.is_ground(pair[1]) else ""


def _between(solids: Solids, a: int, b: int) -> tuple[int, ...]:
    """Return the parts whose joints are between two parts."""
    ways: list[list[int]] = []
    for part in (a, b):
        way = []
        while part > 0:
            way.append(part)
            part = solids.parents[part]
        ways.append(way)
    return tuple(sorted(set(ways[0]) ^ set(ways[1])))


def _by_joints(
    solids: Solids, scene: _Scene, pairs: Sequence[_Numbers]
) -> dict[tuple[int, ...], list[_Numbers]]:
    """Return the pairs with few joints between them, by these."""
    found: dict[tuple[int, ...], list[_Numbers]] = {}
    for pair in pairs:
        between = _between(solids, scene.part(pair[0]), scene.part(pair[1]))
        single = all(solids.moves[k].stop - solids.moves[k].start == 1 for k in between)
        if len(between) <= _NEAR and single:
            found.setdefault(between, []).append(pair)
    return found


def _can_touch(
    robot: Any, solids: Solids, scene: _Scene, joints: tuple[int, ...], pairs: list[_Numbers]
) -> list[bool]:
    """Return which pairs touch in some position of the joints between them."""
    columns = [solids.moves[k].start for k in joints]
    rest = np.asarray(robot.rest)
    low, high = np.transpose([_span(robot, rest, column) for column in columns])

    def placed(values: Array) -> Array:
        """Return the placements at displacements of the joints, shape (n, joints)."""
        moved = np.zeros((len(values), robot.nv))
        moved[:, columns] = values
        return np.asarray(robot.solid_placements(robot.integrate(rest, moved)))

    tried = _lattice([np.linspace(a, b, _GRID) for a, b in zip(low, high, strict=True)])
    width, around = (high - low) / (_GRID - 1), _lattice([np.linspace(-1, 1, 5)] * len(columns))
    placements = placed(tried)
    bounds = scene.bounds(placements, pairs)
    found = []
    for pair, bound in zip(pairs, bounds.T, strict=True):
        order = np.argsort(bound)
        deep = [k for k in order if bound[k] <= _TOUCH]
        if any(scene.overlaps(placements[k], pair) for k in deep):
            found.append(True)
            continue
        least = [scene.exact(placements[k], pair) for k in order[:_STARTS]]
        centre, nearest = tried[order[int(np.argmin(least))]], min(least)
        for finer in range(_FINER):
            near = np.clip(centre + width * 0.5**finer * around, low, high)
            here = [scene.exact(each, pair) for each in placed(near)]
            centre, nearest = near[int(np.argmin(here))], min(nearest, *here)
        found.append(nearest <= _TOUCH)
    return found


def _lattice(values: Sequence[Array]) -> Array:
    """Return all combinations of numbers, shape (n, k)."""
    return np.stack(np.meshgrid(*values, indexing="ij"), axis=-1).reshape(-1, len(values))


def _span(robot: Any, rest: Array, column: int) -> tuple[float, float]:
    """Return how far a joint may be from rest to either side: a whole turn is enough."""
    one = robot.coordinates[column]
    low, high = one.lower - rest[column], one.upper - rest[column]
    far = np.pi if one.unit == "rad" else 1.0
    if high - low > 2 * far:
        return -far, far
    return float(low), float(high)


class _Scene:
    """Shapes in coal, in groups by their links, and the ground.

    Parameters
    ----------
    shapes : sequence of Solid
        What there is.
    """

    def __init__(self, shapes: Sequence[Solid]) -> None:
        import coal

        self.links = tuple(dict.fromkeys(shape.link for shape in shapes))
        self._parts = {shape.link: shape.part for shape in shapes}
        self._of = [[k for k, shape in enumerate(shapes) if shape.link == link] for link in self.links]
        self._of.append([len(shapes)])
        plane = coal.Halfspace(np.array([0.0, 0.0, 1.0]), 0.0)
        self._convex = [*(shape.geometry for shape in shapes), plane]
        self._meshes = [*(shape.mesh for shape in shapes), None]
        self.model = pin.GeometryModel()
        for k, geometry in enumerate(self._convex):
            self.model.addGeometryObject(pin.GeometryObject(f"{k}", 0, pin.SE3.Identity(), geometry))

    def is_ground(self, k: int) -> bool:
        """Return whether a link is the ground."""
        return k == len(self.links)

    def part(self, k: int) -> int:
        """Return what a link moves with: the ground, which is level, with the body."""
        return 0 if self.is_ground(k) else self._parts[self.links[k]]

    def named(self, pair: _Numbers) -> Pair:
        """Return the names of two links."""
        a, b = (GROUND if self.is_ground(k) else self.links[k] for k in pair)
        return a, b

    def bounds(self, placements: Array, pairs: Sequence[_Numbers]) -> Array:
        """Return what the distances of pairs of links are at least, those of hulls, shape (n, pairs) [m].

        Parameters
        ----------
        placements : ndarray, shape (n, shapes, 4, 4)
            Of the shapes.
        pairs : sequence of (int, int)
            Numbers of links.
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
            _make_exact(request)
        data.oMg[len(self._convex) - 1] = pin.SE3.Identity()
        found = np.empty((len(placements), len(model.collisionPairs)))
        for row, out in zip(placements, found, strict=True):
            for k, placement in enumerate(row):
                data.oMg[k] = pin.SE3(placement)
            for request in requests:  # what was found before has no say in the last digits
                request.cached_gjk_guess, request.cached_support_func_guess = _GUESS
            pin.computeDistances(model, data)
            out[:] = [result.min_distance for result in results]
        found[found < _FAILED] = -_TOUCH  # they overlap
        return np.asarray(np.minimum.reduceat(found, starts, axis=1))

    def _shapes(self, pair: _Numbers) -> list[_Numbers]:
        return [(i, j) for i in self._of[pair[0]] for j in self._of[pair[1]]]

    def has_mesh(self, pair: _Numbers) -> bool:
        """Return whether the distance of two links may be larger than that of their hulls.

        Of a hull and the ground it is not.
        """
        meshes = (self._meshes[k] for one in pair for k in self._of[one])
        return not self.is_ground(pair[1]) and any(mesh is not None for mesh in meshes)

    def distances(self, placements: Array, pairs: Sequence[_Numbers]) -> Array:
        """Return the distances of pairs, shape (n, pairs) [m]: the nearest to the last digit.

        Of pairs with meshes that are not the nearest it is what `bounds` gives, at least.
        """
        found = self.bounds(placements, pairs)
        meshes = [self.has_mesh(pair) for pair in pairs]
        if not any(meshes):
            return found
        for row, out in zip(placements, found, strict=True):
            nearest = np.inf
            for k in np.argsort(out):
                if out[k] >= nearest:
                    break
                out[k] = self.exact(row, pairs[k]) if meshes[k] else out[k]
                nearest = min(nearest, out[k])
        return found

    def exact(self, placements: Array, pair: _Numbers) -> float:
        """Return the distance of two links [m], of shapes with placements, shape (shapes, 4, 4).

        Where meshes overlap it is that of their hulls.
        """
        return min(self._exact(i, j, placements) for i, j in self._shapes(pair))

    def _exact(self, i: int, j: int, placements: Array) -> float:
        import coal

        places = [self._place(k, placements) for k in (i, j)]
        request, result = coal.DistanceRequest(), coal.DistanceResult()
        _make_exact(request)
        hulls = float(coal.distance(self._convex[i], places[0], self._convex[j], places[1], request, result))
        hulls = hulls if hulls > _FAILED else -_TOUCH
        if j == len(self._convex) - 1 or (self._meshes[i] is None and self._meshes[j] is None):
            return hulls
        result = coal.DistanceResult()
        solid = float(coal.distance(self._solid(i), places[0], self._solid(j), places[1], request, result))
        if solid <= _TOUCH or (hulls < 0 and self._encloses(i, j, placements)):
            return min(hulls, solid)
        return solid

    def overlaps(self, placements: Array, pair: _Numbers) -> bool:
        """Return whether two links overlap."""
        import coal

        for i, j in self._shapes(pair):
            places = [self._place(k, placements) for k in (i, j)]
            request, result = coal.CollisionRequest(), coal.CollisionResult()
            if coal.collide(self._solid(i), places[0], self._solid(j), places[1], request, result):
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
        """Return whether one of two shapes that do not cross is in the other."""
        for outer, inner in ((i, j), (j, i)):
            mesh = self._meshes[outer]
            if mesh is None:
                continue  # a primitive is solid: what is in it overlaps
            point = _point_of(self._solid(inner))
            there = placements[inner] @ np.append(point, 1.0)
            local = np.linalg.solve(placements[outer], there)[:3]
            if _winding(mesh, local) > _INSIDE:
                return True
        return False


def _make_exact(request: Any) -> None:
    request.gjk_tolerance, request.gjk_max_iterations = _EXACT, _ITERATIONS
    request.epa_tolerance, request.epa_max_iterations = _DEEP, _DEEP_ITERATIONS


def _point_of(geometry: Any) -> Array:
    """Return a point of a shape: a vertex of a mesh, else its middle."""
    return np.array(geometry.vertices()[0]) if hasattr(geometry, "num_tris") else np.zeros(3)


def _winding(mesh: Any, point: Array) -> float:
    """Return how often a mesh goes round a point: one inside, zero outside (van Oosterom, Strackee, 1983)."""
    triangles = (mesh.tri_indices(k) for k in range(mesh.num_tris))
    faces = np.array([[triangle[0], triangle[1], triangle[2]] for triangle in triangles])
    a, b, c = np.moveaxis((np.asarray(mesh.vertices()) - point)[faces], 1, 0)
    A, B, C = (np.linalg.norm(x, axis=1) for x in (a, b, c))
    ab, bc, ca = (np.einsum("ij,ij->i", *pair) for pair in ((a, b), (b, c), (c, a)))
    spread = A * B * C + ab * C + bc * A + ca * B
    turns = 2 * np.arctan2(np.einsum("ij,ij->i", a, np.cross(b, c)), spread)
    return abs(float(turns.sum())) / (4 * np.pi)
