"""Laws on symbols: a loop's parts, written in NumPy for one state, as vector code for many robots."""

from pinmobile.compiled.batched import Batched
from pinmobile.compiled.emit import BINS, FIRST, SHIFT, Shape
from pinmobile.compiled.known import memory_of, once, program_of
from pinmobile.compiled.loop_tape import Loop
from pinmobile.compiled.machine import Cache, Target
from pinmobile.compiled.memory import Line
from pinmobile.compiled.noise import Noise, robot_keys
from pinmobile.compiled.parts import Memory, Parts, Place, Reference, Stepped, one_sample
from pinmobile.compiled.passes import traced
from pinmobile.compiled.program import Outcome, Program
from pinmobile.compiled.recorders import Record, Sample, Summary, Trace

__all__ = [
    "BINS",
    "FIRST",
    "SHIFT",
    "Batched",
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
]
