"""Laws on symbols: a loop's parts, written in NumPy for one state, as vector code for many robots."""

from pinmobile.compiled._vectorize import vectorize
from pinmobile.compiled.elementary import sincos as sincos
from pinmobile.compiled.emit import BINS, FIRST, SHIFT, Shape
from pinmobile.compiled.loop_tape import (
    Loop,
    arrays_of as arrays_of,
    check_schedules as check_schedules,
    initial_memory as initial_memory,
)
from pinmobile.compiled.memory import (
    Line,
    Noise,
    Schedule,
    leaves as leaves,
    mapped as mapped,
    robot_keys,
)
from pinmobile.compiled.parts import (
    Parts,
    Place,
    attributes_of as attributes_of,
    check_made_again as check_made_again,
    check_numbers as check_numbers,
    children as children,
    children_at as children_at,
    copied as copied,
    derived as derived,
    displaced as displaced,
)
from pinmobile.compiled.passes import traced
from pinmobile.compiled.processor import Cache, Target, processors as processors
from pinmobile.compiled.program import Outcome, Program, aligned as aligned
from pinmobile.compiled.program_cache import memory_of, once, program_of
from pinmobile.compiled.sample import (
    NOTHING as NOTHING,
    Memory,
    Record,
    Reference,
    Sample,
    Stepped,
    Summary,
    Trace,
    moved_on as moved_on,
    one_sample,
    reaction as reaction,
    told_by as told_by,
    tracking_errors as tracking_errors,
)
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

__all__ = [
    "BINS",
    "FIRST",
    "SHIFT",
    "Cache",
    "Line",
    "Loop",
    "Memory",
    "Noise",
    "Outcome",
    "Parts",
    "Place",
    "Program",
    "Record",
    "Reference",
    "Sample",
    "Schedule",
    "Shape",
    "Stepped",
    "Summary",
    "Target",
    "Trace",
    "memory_of",
    "once",
    "one_sample",
    "program_of",
    "robot_keys",
    "traced",
    "vectorize",
]
