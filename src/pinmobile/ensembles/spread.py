"""What a spread may say: names of parameters, and for each a distribution, numbers or `Same`."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from pinmobile.arrays import finite
from pinmobile.ensembles.distributions import Same, Uniform
from pinmobile.ensembles.names import Stated, resolved
from pinmobile.errors import InvalidArgument, shown
from pinmobile.plant import Parameter

__all__ = ["check_mapping", "check_supports", "checked_spread"]


def checked_spread(spread: Any, n: int, known: Mapping[str, list[Stated]]) -> dict[str, Any]:
    """Return a spread whose names and sources are what is expected; arrays are checked and copied.

    Parameters
    ----------
    spread : mapping
        As a user gives it.
    n : int
        Number of robots.
    known : mapping
        The parameters that there are, by name.

    Raises
    ------
    UnknownName
        If there is no such parameter.
    InvalidArgument
        If a source is no distribution, number, array of shape (n,) or `Same`, or refers in a circle.
    """
    check_mapping(spread)
    found = {}
    for name, source in spread.items():
        resolved(name, known)
        found[name] = _checked(f"spread[{name!r}]", source, n)
        if isinstance(source, Same):
            _follow(name, source, spread, known)
    return found


def check_mapping(spread: Any) -> None:
    """Refuse a spread that is no mapping.

    Raises
    ------
    InvalidArgument
        If it is not.
    """
    if not isinstance(spread, Mapping):
        raise InvalidArgument(f"spread is {shown(spread)}, expected a mapping of parameters to distributions")


def check_supports(spread: Mapping[str, Any], parameters: Mapping[str, Parameter]) -> None:
    """Refuse distributions that reach below what is possible, whatever happens to be drawn.

    Raises
    ------
    InvalidArgument
        If one does; the message tells the share of its draws.
    """
    for name, source in spread.items():
        parameter = parameters[name]
        told = isinstance(source, Uniform) or (hasattr(source, "rvs") and not hasattr(source, "sample"))
        low = float(source.support()[0]) if told else np.nan
        if np.isfinite(low) and low < parameter.least:
            raise InvalidArgument(
                f"spread[{name!r}] reaches {low:.6g} {parameter.unit} as the {parameter.meaning}, and "
                f"{float(source.cdf(parameter.least)):.2%} of its draws are impossible; "
                f"expected {parameter.bound}"
            )


def _checked(what: str, source: Any, n: int) -> Any:
    if isinstance(source, Same):
        return Same(source.name, _checked(f"{what}.factor", source.factor, n))
    if isinstance(source, type):
        raise InvalidArgument(
            f"{what} is the class {source.__name__}, expected one of it, such as Uniform(1, 2)"
        )
    numbers = hasattr(source, "__array__")  # as of a column of pandas, which has a `sample` too
    if not numbers and (hasattr(source, "sample") or hasattr(source, "rvs")):
        return source
    values = finite(what, source)
    if values.shape not in ((), (n,)):
        raise InvalidArgument(f"{what} has shape {values.shape}, expected () or ({n},)")
    return values.copy()


def _follow(name: str, source: Same, spread: Mapping[str, Any], known: Mapping[str, list[Stated]]) -> None:
    seen = [name]
    while isinstance(source, Same):
        resolved(source.name, known, f"spread[{seen[-1]!r}]")
        seen.append(source.name)
        if len(set(seen)) < len(seen):
            raise InvalidArgument(f"spread goes in a circle: {' is the same as '.join(seen)}")
        source = spread.get(source.name)  # type: ignore[assignment]
