"""Worker processes for loops that hold the interpreter's lock, such as those that ask Pinocchio.

A worker is an interpreter of its own that runs no file of the user's: it imports what pickled parts name. So
nothing is forked, and a script needs no guard around what it does.
"""

from __future__ import annotations

import pickle
import subprocess
import sys
import threading
from collections.abc import Mapping
from io import BytesIO
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from traceback import format_exception
from types import FunctionType, TracebackType
from typing import Any, Self

from pinmobile.arrays import Array
from pinmobile.ensembles.part import Part
from pinmobile.errors import InvalidArgument, SchedulerError

START = 1.5
"""Seconds of a processor until a worker runs its first robot: to start Python and to import Pinocchio."""


class _Pickler(pickle.Pickler):
    """A pickler that refuses what another process cannot have, though it has a name here."""

    def reducer_override(self, thing: Any) -> Any:
        if isinstance(thing, type | FunctionType):
            home = sys.modules.get(thing.__module__)
            if thing.__module__ == "__main__" or getattr(home, "__spec__", None) is None:
                raise pickle.PicklingError(
                    f"{thing.__qualname__} is of {thing.__module__}, which they cannot import"
                )
        return NotImplemented


def packed_way(way: Any) -> bytes:
    """Return a way to run a scenario as bytes for workers.

    Raises
    ------
    InvalidArgument
        If a part cannot be sent to another process; the message says why, in a few words.
    """
    if not sys.executable:
        raise InvalidArgument("there is no interpreter to start workers with")
    buffer = BytesIO()
    try:
        _Pickler(buffer).dump(way)
    except Exception as error:  # whatever a part's own pickling raises
        said = " ".join(str(error).split())
        raise InvalidArgument(f"a part cannot be sent to other processes: {said}") from error
    return buffer.getvalue()


class _Worker:
    """A process, and the line to it."""

    def __init__(self) -> None:
        self.line, theirs = Pipe()
        code = (
            f"import sys; sys.path[:] = {sys.path!r}; "
            f"from pinmobile.ensembles.processes import serve; serve({theirs.fileno()})"
        )
        # In a session of its own, Ctrl-C reaches this process alone, which ends the others.
        self.process = subprocess.Popen(
            [sys.executable, "-c", code], pass_fds=[theirs.fileno()], start_new_session=True
        )
        theirs.close()
        self.known: bytes | None = None

    def part(self, way: bytes, draws: Mapping[str, Array], start: int, stop: int) -> Part:
        try:
            if self.known is not way:
                self.line.send_bytes(way)
                self.known = way
            self.line.send_bytes(pickle.dumps((draws, start, stop)))
            answer = self.line.recv_bytes()
        except (EOFError, OSError) as error:
            code = self.process.wait()
            raise SchedulerError(
                f"a worker process ended with code {code} while it ran robots {start} to {stop - 1}"
            ) from error
        error_, result = pickle.loads(answer)
        if error_ is not None:
            raise error_
        return Part(*result)


class Workers:
    """Processes that run robots; they are started when they are first needed, and end with the block.

    Parameters
    ----------
    count : int
        How many at most.
    """

    def __init__(self, count: int) -> None:
        self.count = count
        self._all: list[_Worker] = []
        self._free: list[_Worker] = []
        self._changed = threading.Condition()
        self._ended = False

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.end()

    def part(self, way: bytes, draws: Mapping[str, Array], start: int, stop: int) -> Part:
        """Return the records of the robots from `start` to before `stop`, by the next worker that is free.

        Parameters
        ----------
        way : bytes
            How they are run, as `packed_way` returns it.
        draws : mapping of str to ndarray, shape (stop - start,)
            What is drawn for them.
        start, stop : int
            Which robots.

        Raises
        ------
        SchedulerError
            If the worker is lost.
        Exception
            Whatever a part raises there.
        """
        worker = self._taken()
        try:
            return worker.part(way, draws, start, stop)
        finally:
            with self._changed:
                self._free.append(worker)
                self._changed.notify()

    def _taken(self) -> _Worker:
        with self._changed:
            while not self._free and len(self._all) == self.count and not self._ended:
                self._changed.wait()
            if self._ended:
                raise SchedulerError("the worker processes were ended")
            if not self._free:
                self._all.append(_Worker())
                return self._all[-1]
            return self._free.pop()

    def end(self) -> None:
        """End all workers at once, whatever they are doing."""
        with self._changed:
            self._ended = True
            self._changed.notify_all()
        for worker in self._all:
            worker.process.terminate()
        for worker in self._all:
            worker.process.wait()
            worker.line.close()


def serve(descriptor: int) -> None:
    """Run robots as the process at the other end of a line asks, until it is gone.

    Parameters
    ----------
    descriptor : int
        Of this end of the line.
    """
    line, way = Connection(descriptor), None
    while True:
        try:
            asked = pickle.loads(line.recv_bytes())
            if not isinstance(asked, tuple):
                way = asked
                continue
            draws, start, stop = asked
            answer: tuple[Any, Any] = None, tuple(way.run(draws, start, stop, 1))  # type: ignore[union-attr]
        except EOFError:
            return
        except Exception as error:
            answer = _sent(error), None
        try:
            line.send_bytes(pickle.dumps(answer))
        except OSError:
            return


def _sent(error: Exception) -> Exception:
    """Return an error as it comes back: itself, with where it was raised, or its words where it does not."""
    trace = "".join(format_exception(error))
    try:
        found: Exception = pickle.loads(pickle.dumps(error))
        for note in getattr(error, "__notes__", []):
            if note not in getattr(found, "__notes__", []):
                found.add_note(note)
    except Exception:  # of a class that cannot be made again
        notes = "; ".join(["", *getattr(error, "__notes__", [])])
        found = InvalidArgument(f"a part raises {type(error).__name__}: {error}{notes}")
    found.add_note(f"in a worker process:\n{trace}")
    return found
