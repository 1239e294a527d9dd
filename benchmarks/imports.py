"""What an import and the first use of a name cost, beside Pinocchio and the peers, each in a fresh process.

python benchmarks/imports.py [--quick] [--rounds N]
"""

import sys
from collections.abc import Sequence
from functools import partial
from tempfile import TemporaryDirectory

from contestants import MUJOCO, NUMPY, PINMOBILE, PYTHON, TOOLBOX, Peer
from measuring import Row, about, console, interleaved, last_line, options, say, table

MODULES = {
    "pinmobile": PINMOBILE,
    "pinocchio": PYTHON,
    "numpy": NUMPY,
    "meshcat": Peer("meshcat", "meshcat", "pip install meshcat"),
    "matplotlib.pyplot": Peer("matplotlib", "matplotlib", "pip install matplotlib"),
    "sympy": Peer("sympy", "sympy", "pip install sympy"),
    "mujoco": MUJOCO,
    "roboticstoolbox": TOOLBOX,
}
# A module of this package is loaded when a name of it is first used, so what follows an import counts too.
FIRST_USES = (
    "from pinmobile import MobileRobot",
    "from pinmobile import PD, Circle, ComputedTorque, MobileRobot, Tangent, simulate",
    "from pinmobile import *",
)
TIMED = "from time import perf_counter as now; t = now(); {}; print('\\n', now() - t)"


def main(arguments: Sequence[str] | None = None) -> int:
    chosen = options(__doc__.splitlines()[0]).parse_args(arguments)
    rounds = chosen.rounds or (1 if chosen.quick else 9)
    out = console()
    out.print(about(), f"medians over {rounds} interleaved rounds, after one that fills the caches", sep="; ")
    statements = {f"import {m}": peer for m, peer in MODULES.items()} | dict.fromkeys(FIRST_USES, PINMOBILE)
    with out.status("importing"), TemporaryDirectory() as folder:
        turns = {s: partial(milliseconds, s, folder) for s, peer in statements.items() if peer.installed}
        interleaved(turns, 1)
        times = interleaved(turns, rounds)
    base = Row("pinocchio", times=times["import pinocchio"])
    shown, others = table("\nIn a fresh process", "statement", "version", "ms", "of import pinocchio"), []
    for statement, peer in statements.items():
        if statement in times:
            row = Row(statement, times=times[statement])
            shown.add_row(statement, peer.version, f"{row.median:.0f}", f"{row.ratio(base):.2f}")
        else:
            others.append(f"{statement}: not installed: {peer.install}")
    out.print(shown)
    say(out, others)
    return 0


def milliseconds(statement: str, compiled: str) -> float:
    """Return what a statement takes in a fresh interpreter that keeps bytecode in the folder `compiled`.

    Its own start is not counted. In a folder of their own the bytecodes of all are there from the second
    round on, also where nothing may be written beside the sources or into a checkout.
    """
    command = [sys.executable, "-W", "ignore", "-c", TIMED.format(statement)]
    kept = {"PYTHONPYCACHEPREFIX": compiled, "PYTHONDONTWRITEBYTECODE": ""}
    return float(last_line(command, **kept)) * 1e3


if __name__ == "__main__":
    sys.exit(main())
