"""Every benchmark, one after the other: `python benchmarks [--quick] [--rounds N]`."""

import sys

import arm
import calls
import ensembles
import imports
import memory
import rollout
import viewing

if __name__ == "__main__":
    sys.exit(max(part.main() for part in (rollout, arm, ensembles, calls, memory, viewing, imports)))
