"""What may differ from robot to robot, and the draws of it: the same for every division into chunks."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any
from zlib import crc32

import numpy as np

from pinmobile.arrays import Array, finite
from pinmobile.ensembles.distributions import Same, drawn
from pinmobile.errors import InvalidArgument, UnknownName

__all__ = [
    "PARAMETERS", "Parameter", "check_supports", "checked_spread", "draw", "held", "in_blocks", "stream",
]  # fmt: skip

_BLOCK = 4096  # robots that are drawn from one stream of random numbers


@dataclass(frozen=True)
class Parameter:
    """A number of each robot that may be spread.

    Attributes
    ----------
    unit : str
        Its unit, "" for none.
    meaning : str
        What it is, in words.
    least : float
        Values must be above, or for 0 of a parameter that may vanish, at least this.
    may_vanish : bool
        Whether `least` itself is allowed.
    """

    unit: str
    meaning: str
    least: float = -np.inf
    may_vanish: bool = True

    def allows(self, values: Array) -> Any:
        """Tell which values are possible, shape (n,)."""
        return values >= self.least if self.may_vanish else values > self.least


def _body(prefix: str, of: str) -> dict[str, Parameter]:
    return {
        f"{prefix}mass": Parameter("kg", f"mass of {of}", 0.0, may_vanish=False),
        f"{prefix}yaw_inertia": Parameter("kg m^2", f"yaw inertia of {of}", 0.0, may_vanish=False),
        f"{prefix}com_x": Parameter("m", f"centre of mass of {of}, forward"),
        f"{prefix}com_y": Parameter("m", f"centre of mass of {of}, left"),
    }


def _gains() -> dict[str, Parameter]:
    found = {}
    for gain in ("kp", "kd"):
        found[gain] = Parameter("", f"{gain} of all three coordinates, in place of the controller's")
        for coordinate in ("x", "y", "psi"):
            found[f"{gain}_{coordinate}"] = Parameter("", f"{gain} of {coordinate} alone")
        found[f"{gain}_factor"] = Parameter("", f"by which {gain} is multiplied")
    return found


def _forces() -> dict[str, Parameter]:
    axes = (("forward", "N"), ("left", "N"), ("yaw", "N m"))
    viscous = {"forward": "N s/m", "left": "N s/m", "yaw": "N m s"}
    return {
        "force_x": Parameter("N", "constant force along x"),
        "force_y": Parameter("N", "constant force along y"),
        "moment_z": Parameter("N m", "constant moment"),
        "sine_x": Parameter("N", "amplitude of the sinusoidal force along x"),
        "sine_y": Parameter("N", "amplitude of the sinusoidal force along y"),
        "sine_moment": Parameter("N m", "amplitude of the sinusoidal moment"),
        "sine_frequency": Parameter("Hz", "its frequency", 0.0),
        "sine_phase": Parameter("rad", "its phase"),
        "noise_x": Parameter("N", "rms of the noise force along x", 0.0),
        "noise_y": Parameter("N", "rms of the noise force along y", 0.0),
        "noise_moment": Parameter("N m", "rms of the noise moment", 0.0),
        **{f"viscous_{a}": Parameter(unit, f"viscous friction, {a}", 0.0) for a, unit in viscous.items()},
        **{f"rolling_{a}": Parameter(unit, f"rolling resistance, {a}", 0.0) for a, unit in axes},
    }


PARAMETERS: Mapping[str, Parameter] = {
    **_body("", "the robot"),
    **_body("model_", "the controller's model"),
    "start_x": Parameter("m", "start, from the trajectory's along x"),
    "start_y": Parameter("m", "start, from the trajectory's along y"),
    "start_psi": Parameter("rad", "start, from the trajectory's heading"),
    "start_vx": Parameter("m/s", "velocity at the start, from the trajectory's along x"),
    "start_vy": Parameter("m/s", "velocity at the start, from the trajectory's along y"),
    "start_yaw_rate": Parameter("rad/s", "yaw rate at the start, from the trajectory's"),
    **_gains(),
    **_forces(),
}
"""Every parameter that a spread may name."""


def checked_spread(spread: Any, n: int) -> dict[str, Any]:
    """Return a spread whose names and sources are what is expected; arrays are checked and copied.

    Raises
    ------
    UnknownName
        If there is no such parameter.
    InvalidArgument
        If a source is no distribution, number, array of shape (n,) or `Same`, or refers in a circle.
    """
    if not isinstance(spread, Mapping):
        raise InvalidArgument(f"spread is {spread!r}, expected a mapping of parameters to distributions")
    found = {}
    for name, source in spread.items():
        if name not in PARAMETERS:
            raise UnknownName("parameter in spread", str(name), PARAMETERS)
        found[name] = _checked(f"spread[{name!r}]", source, n)
        if isinstance(source, Same):
            _follow(name, source, spread)
    return found


def check_supports(spread: Mapping[str, Any]) -> None:
    """Refuse distributions that reach below what is possible, whatever happens to be drawn.

    Raises
    ------
    InvalidArgument
        If one does; the message tells the share of its draws.
    """
    for name, source in spread.items():
        parameter, support = PARAMETERS[name], getattr(source, "support", None)
        low = float(support()[0]) if callable(support) else np.nan
        if np.isfinite(low) and low < parameter.least:
            raise InvalidArgument(
                f"spread[{name!r}] reaches {low:.6g} {parameter.unit} as the {parameter.meaning}, and "
                f"{float(source.cdf(parameter.least)):.2%} of its draws are impossible; "
                f"expected {'>=' if parameter.may_vanish else '>'} 0"
            )


def _checked(what: str, source: Any, n: int) -> Any:
    if isinstance(source, Same):
        return Same(source.name, _checked(f"{what}.factor", source.factor, n))
    if isinstance(source, type):
        raise InvalidArgument(
            f"{what} is the class {source.__name__}, expected one of it, such as Uniform(1, 2)"
        )
    if hasattr(source, "sample") or hasattr(source, "rvs"):
        return source
    values = finite(what, source)
    if values.shape not in ((), (n,)):
        raise InvalidArgument(f"{what} has shape {values.shape}, expected () or ({n},)")
    return values.copy()


def _follow(name: str, source: Same, spread: Mapping[str, Any]) -> None:
    seen = [name]
    while isinstance(source, Same):
        if source.name not in PARAMETERS:
            raise UnknownName(f"parameter in spread[{seen[-1]!r}]", str(source.name), PARAMETERS)
        seen.append(source.name)
        if len(set(seen)) < len(seen):
            raise InvalidArgument(f"spread goes in a circle: {' is the same as '.join(seen)}")
        source = spread.get(source.name)  # type: ignore[assignment]


def stream(seed: int, what: str, *where: int) -> np.random.SeedSequence:
    """Return the seed of a stream of its own for `what`, and for a robot or block of robots."""
    return np.random.SeedSequence(seed, spawn_key=(crc32(what.encode()), *where))


def draw(
    spread: Mapping[str, Any], seed: int, start: int, stop: int, nominal: Mapping[str, float]
) -> dict[str, Array]:
    """Return the values of the robots from `start` to before `stop`, shape (stop - start,) each.

    Parameters
    ----------
    spread : mapping
        As `checked_spread` returns it.
    seed : int
        The seed of the ensemble.
    start, stop : int
        Which robots.
    nominal : mapping of str to float
        The values of what is not spread, for `Same`.

    Raises
    ------
    InvalidArgument
        If a distribution gives what is no number.
    """
    values: dict[str, Array] = {}

    def of(name: str) -> Array:
        if name not in values:
            if name not in spread:
                return np.full(stop - start, nominal[name])
            source = spread[name]
            if isinstance(source, Same):
                values[name] = of(source.name) * _values(f"{name} factor", source.factor, seed, start, stop)
            else:
                values[name] = _values(name, source, seed, start, stop)
        return values[name]

    for name in spread:
        of(name)
    return {name: values[name] for name in spread}


@dataclass(frozen=True)
class _Held:
    """What an explicit array has for the robots from `start` on."""

    start: int
    values: Array


def held(spread: Mapping[str, Any], start: int, stop: int) -> dict[str, Any]:
    """Return a spread that knows, of explicit arrays, the robots from `start` to before `stop` alone.

    Parameters
    ----------
    spread : mapping
        As `checked_spread` returns it.
    start, stop : int
        Which robots.
    """

    def part(source: Any) -> Any:
        if isinstance(source, Same):
            return Same(source.name, part(source.factor))
        if isinstance(source, np.ndarray) and source.ndim:
            return _Held(start, source[start:stop])
        return source

    return {name: part(source) for name, source in spread.items()}


def _values(name: str, source: Any, seed: int, start: int, stop: int) -> Array:
    if isinstance(source, _Held):
        return source.values[start - source.start : stop - source.start].copy()
    if isinstance(source, np.ndarray):
        return np.array(source[start:stop] if source.ndim else np.full(stop - start, source))
    return in_blocks(name, lambda generator, size: drawn(name, source, generator, size), seed, start, stop)


def in_blocks(
    what: str,
    draws: Callable[[np.random.Generator, int], Array],
    seed: int,
    start: int,
    stop: int,
) -> Array:
    """Return draws for the robots from `start` to before `stop`, whatever else is drawn.

    Parameters
    ----------
    what : str
        Name of the stream of random numbers.
    draws : callable
        ``draws(generator, size)`` returns an array of shape (size, ...).
    seed : int
        The seed of the ensemble.
    start, stop : int
        Which robots.
    """
    first = start // _BLOCK
    blocks = [
        draws(np.random.default_rng(stream(seed, what, block)), _BLOCK)
        for block in range(first, -(-stop // _BLOCK))
    ]
    return np.concatenate(blocks)[start - first * _BLOCK : stop - first * _BLOCK]
