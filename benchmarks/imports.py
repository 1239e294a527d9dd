"""What an import costs: pinmobile beside what it stands on and beside the peers, each in a fresh process.

python benchmarks/imports.py [--quick] [--rounds N]
"""

import subprocess
import sys
from collections.abc import Sequence

from contestants import DRAKE, MUJOCO, NUMPY, PINMOBILE, PINOCCHIO, PYBULLET, TOOLBOX, Peer
from measuring import Row, about, console, interleaved, options, say, table

MODULES = {
    "pinmobile": PINMOBILE,
    "pinocchio": PINOCCHIO,
    "numpy": NUMPY,
    "meshcat": Peer("meshcat", "meshcat", "pip install meshcat"),
    "matplotlib.pyplot": Peer("matplotlib", "matplotlib", "pip install matplotlib"),
    "sympy": Peer("sympy", "sympy", "pip install sympy"),
    "mujoco": MUJOCO,
    "pydrake.all": DRAKE,
    "roboticstoolbox": TOOLBOX,
    "pybullet": PYBULLET,
}
TIMED = "from time import perf_counter as now; t = now(); import {}; print('\\n', now() - t)"


def main(arguments: Sequence[str] | None = None) -> int:
    chosen = options(__doc__.splitlines()[0]).parse_args(arguments)
    rounds = chosen.rounds or (1 if chosen.quick else 9)
    out = console()
    out.print(about(), f"medians over {rounds} interleaved rounds, after one that fills the caches", sep="; ")
    turns = {m: (lambda m=m: milliseconds(m)) for m, peer in MODULES.items() if peer.installed}
    with out.status("importing"):
        interleaved(turns, 1)
        times = interleaved(turns, rounds)
    base = Row("pinocchio", times=times["pinocchio"])
    shown, others = table("\nImport in a fresh process", "module", "version", "ms", "of pinocchio"), []
    for name, peer in MODULES.items():
        if name in times:
            row = Row(name, times=times[name])
            shown.add_row(name, peer.version, f"{row.median:.0f}", f"{row.ratio(base):.2f}")
        else:
            others.append(f"{name}: not installed: {peer.install}")
    out.print(shown)
    say(out, others)
    return 0


def milliseconds(module: str) -> float:
    """Return what `import module` takes in a fresh interpreter, its own start not counted."""
    command = [sys.executable, "-W", "ignore", "-c", TIMED.format(module)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    return float(done.stdout.split()[-1]) * 1e3


if __name__ == "__main__":
    sys.exit(main())
