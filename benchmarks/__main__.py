"""Every benchmark, one after the other: `python benchmarks [--quick] [--rounds N] [--only WORD ...]`.

With `--only`, just those in which somebody has such a word in the name, and of these the ones who have. With
`--before PYTHON`, just the loop of parts, beside the version of pinmobile that this interpreter has. The logs
of real robots need clones of public repositories: `python benchmarks/real_logs.py --help`.
"""

import sys
from collections.abc import Sequence
from importlib import import_module

from measuring import picked, selecting

NAMES = (
    *("rollout", "ensembles", "arm_ensembles", "loop", "calls", "batches"),
    *("memory", "wheels", "mpc", "identification", "derivatives", "viewing", "imports", "exported"),
    "realtime",
)
PARTS = [import_module(name) for name in NAMES]


def main(arguments: Sequence[str] | None = None) -> int:
    parser = selecting(__doc__.splitlines()[0])
    given = sys.argv[1:] if arguments is None else arguments
    parser.add_argument("--before", metavar="PYTHON", help="an interpreter that has another version")
    chosen = parser.parse_args(given)
    words = chosen.only
    parts = [part for part in PARTS if not words or picked(vars(part).get("EVERYONE", ()), words)]
    if chosen.before is not None:
        parts = [part for part in parts if part.__name__ == "loop"]
    if not parts:
        parser.error(f"--only: nobody has {' or '.join(map(repr, words))} in the name")
    return max(part.main(given) for part in parts)


if __name__ == "__main__":
    sys.exit(main())
