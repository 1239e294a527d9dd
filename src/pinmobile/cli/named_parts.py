"""Parts that tables of a scenario file name: the library's by short names, users' as ``module:Name``."""

import inspect
import re
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import Any

from pinmobile import InvalidArgument, UnknownName, controllers, forces
from pinmobile.cli import choices
from pinmobile.compiled.parts import attributes_of, check_numbers
from pinmobile.errors import shown
from pinmobile.sweeps import Code

__all__ = ["FORCES", "STEPS", "WRAPPERS", "Maker", "code_in", "is_code"]


def _parameters(make: Callable[..., Any]) -> Mapping[str, inspect.Parameter]:
    try:
        return inspect.signature(make).parameters
    except (ValueError, TypeError):  # as of some that are built in
        return {"arguments": inspect.Parameter("arguments", inspect.Parameter.VAR_KEYWORD)}


def _short(kind: type) -> str:
    """Return the short name of a class: ``"noisy-measurement"`` of NoisyMeasurement, without Force."""
    return "-".join(re.findall(r"[A-Z]+(?![a-z])|[A-Z][a-z]+", kind.__name__.removesuffix("Force"))).lower()


def _classes(package: Any, wanted: Callable[[type], bool]) -> dict[str, Callable[..., Any]]:
    """Return the classes of a package that are wanted, by short names; protocols are none."""
    kinds = [getattr(package, name) for name in package.__all__]
    real = [kind for kind in kinds if isinstance(kind, type) and not getattr(kind, "_is_protocol", False)]
    return {_short(kind): kind for kind in real if wanted(kind)}


WRAPPERS: Mapping[str, Callable[..., Any]] = _classes(
    controllers, lambda kind: "controller" in _parameters(kind)
)
FORCES: Mapping[str, Callable[..., Any]] = _classes(forces, lambda kind: True)
STEPS: Mapping[str, Callable[..., Any]] = {
    name: partial(lambda step: step, step) for name, step in choices.INTEGRATORS.items()
}
_NAMED = ("type", "heading", "integrator")  # keys whose text names a part
_NOTHING: Mapping[str, Any] = {}
_REFERENCE = re.compile(r"[^\W\d]\w*(\.[^\W\d]\w*)*:[^\W\d]\w*(\.[^\W\d]\w*)*")


def is_code(name: Any) -> bool:
    """Tell whether a text names what is in a user's module."""
    return isinstance(name, str) and ":" in name


def code_in(key: str, value: Any) -> Iterator[str]:
    """Yield the names of users' parts in a value of a key, whatever it holds."""
    if key in _NAMED and is_code(value):
        yield value
    for inner, part in value.items() if isinstance(value, Mapping) else ():
        yield from code_in(inner, part)
    for part in value if isinstance(value, list) else ():
        yield from code_in(key, part)


class Maker:
    """Makes the parts that tables name.

    Parameters
    ----------
    code : Code or None
        The users' modules; None where they must not be run.
    """

    def __init__(self, code: Code | None) -> None:
        self.code = code

    def part(
        self,
        kind: str,
        given: Any,
        available: Mapping[str, Callable[..., Any]],
        *,
        beside: Mapping[str, Any] = _NOTHING,
        first: Any = None,
        taken: set[str] | None = None,
    ) -> Any:
        """Return the part that a name, or a table with a ``type``, stands for.

        Parameters
        ----------
        kind : str
            What it is, such as ``"controller"``.
        given : str or mapping
            The name, or the table, whose other keys are the arguments of its class.
        available : mapping of str to callable
            The library's, by short names.
        beside : mapping of str to object
            What it gets besides where its class takes an argument of that name that the table does not have.
        first : object, optional
            Its first argument.
        taken : set of str, optional
            Where several types share a table: takes the keys that this one takes; others are left out.

        Raises
        ------
        UnknownName, InvalidArgument
            If there is no such part, or it takes other arguments.
        """
        keys = dict(given) if isinstance(given, Mapping) else {"type": given}
        if "type" not in keys:
            raise InvalidArgument(f"{kind} is {shown(given)}, a table without type, expected type = NAME")
        name = keys.pop("type")
        if not isinstance(name, str):
            raise InvalidArgument(f"{kind} has the type {name!r}, expected text in quotes")
        make = self._users(name) if is_code(name) else choices.choose(kind, name, available)
        if is_code(name) and not inspect.isclass(make):
            if taken is None and keys:
                raise InvalidArgument(
                    f"{name} is {shown(make)}, no class, which takes no arguments, but {next(iter(keys))} "
                    "is given"
                )
            return make
        parameters = _parameters(make)
        if taken is not None:
            keys = {key: value for key, value in keys.items() if _takes(parameters, key)}
            taken |= set(keys)
        arguments = {key: self._value(f"{kind}.{key}", value, beside) for key, value in keys.items()}
        more = {key: value for key, value in beside.items() if key in parameters and key not in arguments}
        if first is not None and parameters:
            more = {next(iter(parameters)): first, **more}
        try:
            made = self._called(name, make, parameters, {**more, **arguments})
        except InvalidArgument as error:
            if "." in kind and str(error).split(" ")[0] in arguments:  # as one of several parts of a table
                raise InvalidArgument(f"{kind}.{error}") from error
            raise
        for key in attributes_of(made):
            if key in arguments:
                check_numbers(f"{kind}.{key}", arguments[key])
        return made

    def _users(self, name: str) -> Any:
        if not _REFERENCE.fullmatch(name):
            raise InvalidArgument(f"{name!r} names no part, expected 'module:Name'")
        if self.code is None:
            raise InvalidArgument(f"{name} is code, which is not allowed to run")
        return self.code.named(name)

    def _called(
        self, name: str, make: Callable[..., Any], parameters: Mapping[str, Any], arguments: dict[str, Any]
    ) -> Any:
        takes = ", ".join(parameters) or "nothing"
        for key in arguments:
            if not _takes(parameters, key):
                raise UnknownName(f"argument of {name}", key, parameters)
        for key, parameter in parameters.items():
            variadic = parameter.kind in (parameter.VAR_POSITIONAL, parameter.VAR_KEYWORD)
            if key not in arguments and parameter.default is parameter.empty and not variadic:
                raise InvalidArgument(f"{name} lacks {key!r}, expected a key of that name; it takes {takes}")
        if self.code is None:
            return make(**arguments)
        with self.code.errors(f"{name} cannot be made"):
            return make(**arguments)

    def _value(self, kind: str, value: Any, beside: Mapping[str, Any]) -> Any:
        """Return an argument: a table with a type is a part, and others may hold such."""
        if isinstance(value, Mapping):
            if "type" in value:
                return self.part(kind, value, self._library(beside), beside=beside)
            return {key: self._value(f"{kind}.{key}", part, beside) for key, part in value.items()}
        return [self._value(kind, part, beside) for part in value] if isinstance(value, list) else value

    def _library(self, beside: Mapping[str, Any]) -> dict[str, Callable[..., Any]]:
        """Return all parts of the library that a table within a table may name."""
        found: dict[str, Callable[..., Any]] = {**WRAPPERS, **FORCES, **STEPS}
        found |= {name: partial(_robot, base) for name, base in choices.ROBOTS.items()}
        found |= {name: partial(_path, name) for name in choices.PATHS}
        found["pd"], found["computed-torque"] = _pd, partial(_computed_torque, beside.get("robot"))
        return found


def _pd(*, kp: Any = None, kd: Any = None) -> Any:
    return choices.controller("pd", None, _gain(kp), _gain(kd), None)


def _computed_torque(
    plant: Any,
    /,
    *,
    kp: Any = None,
    kd: Any = None,
    model_mass: Any = None,
    model_yaw_inertia: Any = None,
    model_com: Any = None,
) -> Any:
    model = _robot(lambda: plant, mass=model_mass, yaw_inertia=model_yaw_inertia, com=model_com)
    return choices.controller("computed-torque", model, _gain(kp), _gain(kd), None)


def _robot(base: Callable[[], Any], /, *, mass: Any = None, yaw_inertia: Any = None, com: Any = None) -> Any:
    return choices.robot(base(), mass=mass, yaw_inertia=yaw_inertia, com=_gain(com))


def _path(name: str, /, **given: Any) -> Any:
    return choices.path(name, given)


def _gain(value: Any) -> Any:
    return tuple(value) if isinstance(value, list) else value


def _takes(parameters: Mapping[str, inspect.Parameter], key: str) -> bool:
    if any(each.kind is each.VAR_KEYWORD for each in parameters.values()):
        return True
    return key in parameters and parameters[key].kind in (
        inspect.Parameter.POSITIONAL_OR_KEYWORD,
        inspect.Parameter.KEYWORD_ONLY,
    )
