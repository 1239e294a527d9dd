"""Laws on symbols: a loop's parts, written in NumPy for one state, as vector code for many robots."""

from pinmobile.compiled._vectorize import vectorize
from pinmobile.compiled.elementary import sincos as sincos
from pinmobile.compiled.emit import BINS as BINS, FIRST as FIRST, SHIFT as SHIFT, Shape as Shape
from pinmobile.compiled.loop_tape import LoopTape as LoopTape
from pinmobile.compiled.memory import (
    Line as Line,
    Noise as Noise,
    Schedule as Schedule,
    leaves as leaves,
    mapped as mapped,
    robot_keys as robot_keys,
)
from pinmobile.compiled.processor import Cache as Cache, Target as Target, processors as processors
from pinmobile.compiled.program import Outcome as Outcome, Program as Program, aligned as aligned
from pinmobile.compiled.symbolic import plain as plain, symbols as symbols
from pinmobile.compiled.tape import (
    Node as Node,
    choose as choose,
    higher as higher,
    maximum as maximum,
    repeated as repeated,
    root as root,
    square_root as square_root,
)

__all__ = ["vectorize"]
