"""What is simulated, and what its loop tells a controller before the first sample."""

import operator
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, Protocol, TypeAlias

import numpy as np

from pinmobile.arrays import Array, callable_as, finite, frozen, positive, sequence, whole
from pinmobile.errors import InvalidArgument, shown

__all__ = [
    "Context",
    "Coordinate",
    "Difference",
    "Input",
    "Parameter",
    "Plant",
    "attributes_of",
    "check_difference",
    "parameters_of",
]

Difference: TypeAlias = Callable[[Array, Array], Array]


def check_difference(difference: Any) -> None:
    """Refuse what cannot be called as ``difference(q0, q1)``, and a subtraction of q1 from q0.

    Raises
    ------
    InvalidArgument
        If it is such.
    """
    if difference is np.subtract or difference is operator.sub:
        raise InvalidArgument(
            f"difference is {shown(difference)}, which returns q0 - q1, expected difference(q0, q1), the "
            "displacement from q0 to q1: write difference=plain_difference"
        )
    callable_as("difference(q0, q1)", difference)


class Plant(Protocol):
    """What `simulate` needs of a plant; `MobileRobot` is one.

    One with joints that turn about several axes has ``integrate_jacobian(q, dq)`` and ``neutral`` too, as
    `MobileRobot` has: without, all integrators are taken for displacements that change at the velocity.
    """

    @property
    def nq(self) -> int:
        """Size of q."""

    @property
    def nv(self) -> int:
        """Size of v and a."""

    @property
    def nu(self) -> int:
        """Size of the input u."""

    def forward_dynamics(self, q: Array, v: Array, u: Array, /) -> Array:
        """Return the acceleration, shape (nv,)."""

    def integrate(self, q: Array, dq: Array, /) -> Array:
        """Return the configuration that the displacement dq leads to, shape (nq,)."""

    def difference(self, q0: Array, q1: Array, /) -> Array:
        """Return the displacement from q0 to q1, shape (..., nv)."""


class Coordinate(NamedTuple):
    """One of the nv numbers of a displacement.

    Attributes
    ----------
    name, unit : str
        Such as ``"psi"`` and ``"rad"``.
    lower, upper : float
        Its limits, infinite where there is none.
    rate : str
        What its rate is called, such as ``"yaw_rate"``; by default ``"<name>_rate"``.
    """

    name: str
    unit: str
    lower: float = -np.inf
    upper: float = np.inf
    rate: str = ""


class Input(NamedTuple):
    """One of the nu numbers of an input.

    Attributes
    ----------
    name, unit : str
        Such as ``"Mz"`` and ``"N m"``.
    lower, upper : float
        Its limits, infinite where there is none.
    """

    name: str
    unit: str
    lower: float = -np.inf
    upper: float = np.inf


@dataclass(frozen=True)
class Parameter:
    """A number of a part that may differ from robot to robot: a part lists its own as ``parameters``.

    A spread, a sweep and a scenario file name it; the part's law reads it from its attribute.

    Attributes
    ----------
    name : str
        What a spread calls it, such as ``"viscous_forward"``.
    unit, meaning : str
        Its unit, "" for none, and what it is, in words.
    least : float
        Values must be above, or for 0 of a parameter that may vanish, at least this.
    may_vanish : bool
        Whether `least` itself is allowed.
    attribute : str
        The part's attribute that has it; by default, what it is called.
    entry : int, optional
        Which number of that attribute it is; None: all of them.
    write : callable, optional
        ``write(values, column, size)`` returns the attribute of m robots, shape (m, ...), from what it was,
        (m, ...), and the numbers of the parameter, (m,); `size` is the number of coordinates that the
        reference has. By default the numbers take the entry's place.
    neutral : float, optional
        Its number where it is not spread; by default, what the attribute has there.
    """

    name: str
    unit: str = ""
    meaning: str = ""
    least: float = -np.inf
    may_vanish: bool = True
    attribute: str = ""
    entry: int | None = None
    write: Callable[[Array, Array, int], Array] | None = None
    neutral: float | None = None

    @property
    def bound(self) -> str:
        """What is expected of its values, such as ``> 0``."""
        return f"{'>=' if self.may_vanish else '>'} {self.least:g}"

    def allows(self, values: Array) -> Any:
        """Tell which values are possible, shape (n,)."""
        return values >= self.least if self.may_vanish else values > self.least

    def written(self, values: Array, column: Array, size: int) -> Array:
        """Return the attribute of m robots with this parameter's numbers in it, shape (m, ...)."""
        if self.write is not None:
            return self.write(values, column, size)
        new = np.array(values, np.float64)
        if self.entry is None:
            new[:] = column.reshape(-1, *(1,) * (values.ndim - 1))
        else:
            new[:, self.entry] = column
        return new

    def nominal(self, value: Any) -> float | None:
        """Return its number in an attribute of one robot; None where all its numbers are not alike."""
        if self.neutral is not None:
            return self.neutral
        array = np.asarray(value, np.float64)
        array = array.diagonal() if array.ndim == 2 else array
        numbers = array if self.entry is None or not array.ndim else array[self.entry]
        return float(numbers.flat[0]) if np.ptp(numbers) == 0 else None


def attributes_of(part: Any) -> tuple[str, ...]:
    """Return the attributes of a part that may differ from robot to robot.

    They hold its parameters, and what each robot draws, which a part lists as ``drawn``.
    """
    stated = [parameter.attribute for parameter in parameters_of(part)]
    return tuple(dict.fromkeys([*stated, *getattr(part, "drawn", ())]))


def parameters_of(part: Any) -> tuple[Parameter, ...]:
    """Return the parameters that a part states; a name alone is one without unit and bound."""
    stated = getattr(part, "parameters", ())
    return tuple(
        Parameter(each, attribute=each) if isinstance(each, str) else _with_attribute(each) for each in stated
    )


def _with_attribute(parameter: Parameter) -> Parameter:
    return parameter if parameter.attribute else replace(parameter, attribute=parameter.name)


@dataclass(frozen=True, eq=False)
class Context:
    """What a controller is told before the first sample: ``controller.initial_state(context)``.

    It holds no dynamics of what is simulated: a controller whose model is wrong stays wrong. A loop makes it;
    `Context.of` makes one for calls by hand.

    Attributes
    ----------
    dt : float
        Time between two samples [s].
    t : ndarray, shape (N + 1,)
        Times of the samples [s].
    difference : callable
        ``difference(q0, q1)``: the displacement from q0 to q1 of the plant, shape (..., nv).
    integrate : callable
        ``integrate(q, dq)``: the plant's configuration to which a displacement leads, shape (..., nq).
    coordinates : tuple of Coordinate
        The plant's, as far as it names them, in the order of v.
    inputs : tuple of Input
        The plant's, as far as it names them, in the order of u.
    reference : Reference or None
        The reference at all samples, q, v and a of shape (N + 1, ...); None in calls by hand.
    trajectory : trajectory or None
        What it is sampled from, for those who look ahead; None in calls by hand.
    nv : int
        Size of v of the plant.
    seed, member : int
        What `normal` follows from: the seed of an ensemble, and the robot's number in it.
    """

    dt: float
    t: Array
    difference: Difference
    integrate: Callable[[Array, Array], Array]
    coordinates: tuple[Coordinate, ...] = ()
    inputs: tuple[Input, ...] = ()
    reference: Any = None
    trajectory: Any = None
    nv: int = 0
    seed: int = 0
    member: int = 0

    def line(self, samples: int) -> Any:
        """Return a delay to keep in the state: ``old, line = line.push(values)``.

        What is pushed, a tree of arrays, comes back `samples` samples later; until then, the first does.
        """
        from pinmobile.compiled.memory import Line

        return Line(whole("samples", samples, least=0))

    def normal(self, name: str, n: int) -> Any:
        """Return noise to keep in the state: ``numbers, noise = noise.draw()``.

        The n numbers of a sample are standard normal and independent; they follow from the seed, the member,
        the name and the number of the sample alone, and are the same bits in every engine.
        """
        from pinmobile.compiled.noise import Noise, robot_keys

        return Noise(robot_keys(self.seed, name, range(self.member, self.member + 1))[0], whole("n", n))

    @classmethod
    def of(
        cls, plant: Any, *, dt: float, t: Array | None = None, reference: Any = None, trajectory: Any = None
    ) -> "Context":
        """Return the context of a loop with this plant.

        Parameters
        ----------
        plant : MobileRobot or other plant
            What is simulated, or whose state is measured.
        dt : float
            Time between two samples [s].
        t : ndarray, shape (N + 1,), optional
            Times of the samples [s]; by default one, at 0.
        reference : Reference, optional
            The reference at these times.
        trajectory : trajectory, optional
            What it is sampled from.

        Raises
        ------
        InvalidArgument
            If the plant cannot compare and move configurations, `dt` is not above zero, or `t` is no row.
        """
        missing = [name for name in ("difference", "integrate") if not callable(getattr(plant, name, None))]
        if isinstance(plant, type) or missing:
            what = f", which has no {missing[0]}" if missing else ""
            raise InvalidArgument(f"plant is {shown(plant)}{what}, expected a MobileRobot or other plant")
        check_difference(plant.difference)
        times = finite("t", np.zeros(1) if t is None else t)
        if times.ndim != 1:
            raise InvalidArgument(f"t has shape {times.shape}, expected (N + 1,)")
        named = _coordinates(plant), _inputs(plant)
        return cls(
            positive("dt", dt, "s"),
            frozen(times),
            plant.difference,
            plant.integrate,
            *named,
            reference,
            trajectory,
            getattr(plant, "nv", 0),
        )


def _coordinates(plant: Any) -> tuple[Coordinate, ...]:
    if hasattr(plant, "coordinates"):
        return sequence("plant.coordinates", plant.coordinates, "a sequence of Coordinate")
    names, units = (getattr(plant, f"coordinate_{what}", ()) for what in ("names", "units"))
    return tuple(map(Coordinate, names, units))


def _inputs(plant: Any) -> tuple[Input, ...]:
    """Return the generalised forces of coordinates, where these are what the plant takes."""
    if hasattr(plant, "inputs"):
        return sequence("plant.inputs", plant.inputs, "a sequence of Input")
    if getattr(plant, "nu", 0) != getattr(plant, "nv", 0):
        return ()
    forces = {"m": "N", "rad": "N m"}
    known = {"x": "Fx", "y": "Fy", "psi": "Mz"}
    found = _coordinates(plant)
    return tuple(Input(known.get(one.name, one.name), forces.get(one.unit, "")) for one in found)
