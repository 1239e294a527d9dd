"""Compilation: laws in NumPy for one state run with symbols and become vector code for many robots."""

from pinmobile.compiled._vectorize import Recurrence as Recurrence, jacobian as jacobian, vectorize
from pinmobile.compiled.differentiation import (
    Copy as Copy,
    adjoint as adjoint,
    expand_delays as expand_delays,
    index_bits as index_bits,
    linearization as linearization,
    sample_index as sample_index,
    sides as sides,
    tangent as tangent,
)
from pinmobile.compiled.elementary import sincos as sincos
from pinmobile.compiled.emit import BINS as BINS, FIRST as FIRST, SHIFT as SHIFT, Shape as Shape
from pinmobile.compiled.folding import DTYPES as DTYPES, NUMPY as NUMPY, ROUND as ROUND
from pinmobile.compiled.functions import (
    law_place as law_place,
    pause_gc as pause_gc,
    place_of as place_of,
    tracing as tracing,
)
from pinmobile.compiled.identity import (
    Contents as Contents,
    Identity as Identity,
    code_of_library as code_of_library,
    is_constant as is_constant,
    is_traced as is_traced,
)
from pinmobile.compiled.memory import (
    DelayLine as DelayLine,
    Noise as Noise,
    Schedule as Schedule,
    leaves as leaves,
    map_leaves as map_leaves,
    match_leaves as match_leaves,
    normals as normals,
    robot_keys as robot_keys,
)
from pinmobile.compiled.program import (
    LOOP as LOOP,
    Cache as Cache,
    Outcome as Outcome,
    Program as Program,
    Target as Target,
    aligned as aligned,
    call as call,
    processors as processors,
)
from pinmobile.compiled.symbolic import (
    Symbols as Symbols,
    entries as entries,
    has_symbols as has_symbols,
    symbols as symbols,
    unwrap as unwrap,
)
from pinmobile.compiled.tape import (
    COUNT as COUNT,
    Leaf as Leaf,
    LoopTape as LoopTape,
    Node as Node,
    Ring as Ring,
    Rounds as Rounds,
    Tape as Tape,
    ancestors as ancestors,
    choose as choose,
    evaluate as evaluate,
    maximum as maximum,
    operands as operands,
    repeat as repeat,
    root as root,
    scalar_max as scalar_max,
    square_root as square_root,
)

__all__ = ["vectorize"]
