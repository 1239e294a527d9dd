"""The forces of an ensemble: what their names in a spread stand for, and those of some robots or of one."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any
from zlib import crc32

import numpy as np

from pinmobile.arrays import Array
from pinmobile.disturbances import (
    ConstantForce,
    NoiseForce,
    RollingResistance,
    SinusoidalForce,
    ViscousFriction,
)
from pinmobile.ensembles.draws import in_blocks
from pinmobile.errors import InvalidArgument

__all__ = ["check_forces", "drawn_force", "force_of_one", "with_spread_forces"]

# What of a force its names in a spread stand for: class, field, and the columns of that field.
_FIELDS: Mapping[str, tuple[type, str, int | None]] = {
    **{name: (ConstantForce, "force", k) for k, name in enumerate(("force_x", "force_y", "moment_z"))},
    **{name: (SinusoidalForce, "amplitude", k) for k, name in enumerate(("sine_x", "sine_y", "sine_moment"))},
    "sine_frequency": (SinusoidalForce, "frequency", None),
    "sine_phase": (SinusoidalForce, "phase", None),
    **{name: (NoiseForce, "std", k) for k, name in enumerate(("noise_x", "noise_y", "noise_moment"))},
    **{
        f"viscous_{a}": (ViscousFriction, "coefficients", k) for k, a in enumerate(("forward", "left", "yaw"))
    },
    **{f"rolling_{a}": (RollingResistance, "force", k) for k, a in enumerate(("forward", "left", "yaw"))},
}


def check_forces(forces: Sequence[Any]) -> None:
    """Refuse forces of the library's that are many: what differs is named in the spread.

    Raises
    ------
    InvalidArgument
        If one has another shape than (3,).
    """
    known = {kind for kind, _, _ in _FIELDS.values()}
    for k, force in enumerate(forces):
        shape = np.shape(force(0.0, np.zeros(3), np.zeros(3))) if type(force) in known else (3,)
        if shape != (3,):
            raise InvalidArgument(
                f"forces[{k}] gives shape {shape} for one robot, expected (3,): name in spread what differs"
            )


def with_spread_forces(forces: Sequence[Any], spread: Mapping[str, Any]) -> tuple[Any, ...]:
    """Return the forces, with those that a spread names and that need no more to be known of them.

    Raises
    ------
    InvalidArgument
        If there are several of a kind that the spread names, or none and more must be known.
    """
    found = list(forces)
    for name in spread:
        if name not in _FIELDS:
            continue
        kind = _FIELDS[name][0]
        count = sum(type(force) is kind for force in found)
        if count > 1:
            raise InvalidArgument(f"forces has {count} {kind.__name__}, expected one for spread[{name!r}]")
        if count == 0:
            found.append(_named_force(kind, name, spread))
    return tuple(found)


def _named_force(kind: type, name: str, spread: Mapping[str, Any]) -> Any:
    if kind is NoiseForce:
        raise InvalidArgument(f"spread has {name!r} but forces no NoiseForce, expected one for its bandwidth")
    if kind is not SinusoidalForce:
        return kind(np.zeros(3))
    if "sine_frequency" not in spread:
        raise InvalidArgument(
            f"spread has {name!r} but no 'sine_frequency' and forces no SinusoidalForce, expected one of them"
        )
    return SinusoidalForce(np.zeros(3), 0.0)


def drawn_force(force: Any, k: int, draws: Mapping[str, Array], seed: int, start: int, size: int) -> Any:
    """Return a force for each of `size` robots from `start` on, with what is drawn of it.

    Parameters
    ----------
    force : force
        The nominal one.
    k : int
        Its place among the scenario's forces.
    draws : mapping of str to ndarray, shape (size,)
        What is drawn.
    seed : int
        That of the ensemble.
    start, size : int
        Which robots.
    """
    changed: dict[str, Array] = {}
    for name, (kind, field, column) in _FIELDS.items():
        if type(force) is kind and name in draws:
            if column is None:
                changed[field] = draws[name]
            else:
                changed.setdefault(field, np.tile(getattr(force, field), (size, 1)))[:, column] = draws[name]
    if type(force) is NoiseForce:

        def phases(generator: np.random.Generator, count: int) -> Array:
            return generator.uniform(0, 2 * np.pi, (count, NoiseForce.TERMS, 3))

        own = crc32(force.phases.tobytes())  # follows from its seed, whatever kind of seed that was
        drawn = in_blocks(f"phases {k} of {own}", phases, seed, start, start + size)
        return NoiseForce.of_phases(changed.get("std", force.std), force.bandwidth, drawn)
    return replace(force, **changed) if changed else force


def force_of_one(force: Any) -> Any:
    """Return a force that `drawn_force` made for a single robot, without the axis for robots."""
    if type(force) is NoiseForce:
        std: Any = force.std
        phases = force.phases[0] if force.phases.ndim == 3 else force.phases
        return NoiseForce.of_phases(std[0] if std.ndim == 2 else std, force.bandwidth, phases)
    fields = {field for kind, field, _ in _FIELDS.values() if type(force) is kind}
    flat = {}
    for field in fields:
        value = getattr(force, field)
        if value.ndim and value.shape[0] == 1 and value.ndim == (1 if field in ("frequency", "phase") else 2):
            flat[field] = value[0]
    return replace(force, **flat) if flat else force
