"""How much memory a process of its own has taken."""

PEAK = """
import resource, sys
from pathlib import Path

def peak():
    # What getrusage tells on Linux may be that of the process which started this one.
    status = Path("/proc/self/status")
    if status.exists():
        lines = status.read_text().splitlines()
        return next(int(line.split()[1]) for line in lines if line.startswith("VmHWM:"))
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (1024 if sys.platform == "darwin" else 1)
"""
"""Code that defines ``peak()``, the largest resident memory so far [kB], for scripts that tests run."""
