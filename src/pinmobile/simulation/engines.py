"""The engines of a closed loop: the same laws, the same numbers."""

from enum import Enum

from pinmobile.errors import InvalidArgument, shown

__all__ = ["ARRAYS", "COMPILED", "PINOCCHIO", "Engine", "checked_engine"]


class Engine(Enum):
    """A way to run a closed loop."""

    PINOCCHIO = "one state at a time, in Python, with Pinocchio's dynamics: any parts"
    ARRAYS = "many robots at once, by NumPy: parts that work on arrays"
    COMPILED = "laws run on symbols and compiled: parts written in NumPy"

    def __repr__(self) -> str:
        return self.name

    __str__ = __repr__


PINOCCHIO = Engine.PINOCCHIO
"""One state at a time, in Python, with Pinocchio's dynamics: any parts."""

ARRAYS = Engine.ARRAYS
"""Many robots at once, by NumPy: parts that work on arrays."""

COMPILED = Engine.COMPILED
"""Laws run on symbols and compiled: parts written in NumPy."""


def checked_engine(engine: object, *known: Engine) -> Engine | None:
    """Return an engine, or None, after refusing what is neither or not among those that are known.

    Raises
    ------
    InvalidArgument
        If it is something else.
    """
    if engine is None or (isinstance(engine, Engine) and engine in known):
        return engine
    names = [repr(each) for each in known]
    meant = str(engine).strip().upper()
    if meant in names:
        raise InvalidArgument(
            f"engine is {shown(engine)}, expected {meant} itself: write engine={meant} after "
            f"'from pinmobile import {meant}'"
        )
    raise InvalidArgument(f"engine is {shown(engine)}, expected {', '.join(names)} of pinmobile, or None")
