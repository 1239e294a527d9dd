"""`run_realtime`, which calls a stepper at a fixed rate, and its report."""

from __future__ import annotations

import ctypes
import gc
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from types import FrameType
from typing import Any, TypeAlias, final

import numpy as np

from pinmobile.arrays import (
    Array,
    ArrayLike,
    callable_as,
    check_integer,
    instance,
    one_of,
    positive,
    positive_or_endless,
    required,
)
from pinmobile.errors import InvalidArgument, format_value
from pinmobile.loop import Rollout
from pinmobile.realtime._stepper import Stepper
from pinmobile.signals import Signal

Measurement: TypeAlias = "tuple[float, ArrayLike, ArrayLike]"
"""Time on the clock of `time.monotonic` [s], configuration and velocity."""

_TIMES = ("lateness", "response time", "measurement age")
_LEVELS = {"median": 0.5, "99 %": 0.99, "99.9 %": 0.999, "largest": 1.0}
_CURRENT_AND_FUTURE = 3  # of mlockall
_SET_SLACK, _GET_SLACK = 29, 30  # of prctl
_CLOCK_MONOTONIC, _ABSOLUTE = 1, 1  # of clock_nanosleep
_LINUX = sys.platform == "linux"
_libc = ctypes.CDLL(None, use_errno=True) if _LINUX else None


@final
@dataclass(frozen=True, eq=False, repr=False)
class RealtimeReport:
    """Result of a run in real time: why it ended, missed deadlines, jitter, and the recorded samples.

    Attributes
    ----------
    reason : str
        ``"duration"``, ``"limit"``, ``"stale measurement"`` or ``"interrupt"`` (Ctrl-C).
    rate : float
        Samples per second [1/s].
    deadlines : int
        Number of periods. The input of each is due before the next one begins.
    overruns : int
        Number of deadlines at which the input was not written: late samples, and those that were left out.
    rollout : Rollout or None
        Recorded samples, at most the capacity of the stepper; None if there is none. Its signals
        ``lateness`` (from the beginning of a period to the start of its sample), ``response time`` (to the
        written input) and ``measurement age`` are in seconds.
    scheduling : tuple of str
        Scheduling of the run, and the reason for each part that the system does not allow.
    details : str
        Values at an end by ``"limit"`` or ``"stale measurement"``; "" for the other reasons.

    See Also
    --------
    realtime.run_realtime : run with such a report.

    Examples
    --------
    >>> from pinmobile.realtime import RealtimeReport
    >>> report = RealtimeReport("duration", 1000.0, 60_000, 6)
    >>> print(report)
    60000 periods at 1000 Hz, 6 deadlines missed (0.01 %), end: duration
    """

    reason: str
    rate: float
    deadlines: int
    overruns: int
    rollout: Rollout | None = None
    scheduling: tuple[str, ...] = field(default=())
    details: str = ""

    @property
    def missed_share(self) -> float:
        """Share of the deadlines that were missed."""
        return self.overruns / max(1, self.deadlines)

    def quantiles(self, name: str = "lateness") -> dict[str, float]:
        """Return median, 99 %, 99.9 % and largest value of a time of the recorded samples [s].

        Parameters
        ----------
        name : str
            ``"lateness"``, ``"response time"`` or ``"measurement age"``.

        Raises
        ------
        UnknownName
            If it is another name.
        """
        one_of("time", name, _TIMES)
        if self.rollout is None:
            return {}
        values = np.quantile(self.rollout.signals[name].values, [*_LEVELS.values()])
        return dict(zip(_LEVELS, values.tolist(), strict=True))

    def __repr__(self) -> str:
        return f"<RealtimeReport: {str(self).splitlines()[0]}>"

    def __str__(self) -> str:
        lines = [
            f"{self.deadlines} periods at {self.rate:g} Hz, {self.overruns} deadlines missed "
            f"({100 * self.missed_share:.3g} %), end: {self.reason}"
            + f", {self.details}"
            * bool(self.details)
        ]
        for name in _TIMES if self.rollout is not None else ():
            quantiles = (f"{level} {1e6 * x:.0f} us" for level, x in self.quantiles(name).items())
            lines.append(f"{name}: {', '.join(quantiles)}")
        return "\n".join([*lines, *self.scheduling])


class _Periods:
    """Periods of a run: wait, measure, compute, write."""

    def __init__(
        self,
        stepper: Stepper,
        read: Callable[[], Measurement | None],
        write: Callable[[Array], object],
        end: float,
        bounds: tuple[float, float],
    ) -> None:
        self.stepper, self.read, self.write = stepper, read, write
        self.period, self.end, (self.stale, self.limit) = stepper.dt, end, bounds
        self.is_interrupted, self.k, self.samples, self.overruns = False, 0, 0, 0
        self.times = np.full((stepper.capacity, len(_TIMES)), 0.0)

    def run(self) -> tuple[str, str]:
        """Return the reason of the end and its details."""
        clock, period = time.monotonic, self.period
        begin = t_measured = clock()
        q: Any = None
        v: Any = None
        while self.k < self.end:
            due = begin + self.k * period
            if self._wait(due):
                return "interrupt", ""
            start = clock()
            measurement = self.read()
            if measurement is not None:
                t_measured, q, v = _check_measurement(measurement)
            age = clock() - t_measured
            if age > self.stale:
                return "stale measurement", self._format_age(age, is_missing=q is None)
            if not age > -period:
                raise InvalidArgument(
                    f"read returned a measurement at {t_measured} s, {-age:.3g} s ahead of the clock, "
                    "expected times of time.monotonic()"
                )
            if q is None:  # time begins with the first measurement
                begin += period
                continue
            u = self.stepper.step(self.k * period, q, v)
            if not self.stepper.largest_error <= self.limit:
                details = f"{self.stepper.format_largest_error()}, expected at most {self.limit:g}"
                self.stepper.remove_last()
                return "limit", details
            self.write(u)
            self._count(begin, due, start, age)
        return "duration", ""

    def _format_age(self, age: float, *, is_missing: bool) -> str:
        if is_missing:
            return f"no measurement arrived within {self.stale:g} s"
        hint = "" if self.samples else ": use times of time.monotonic()"
        return f"the last measurement is {age:.6g} s old, expected at most {self.stale:g} s{hint}"

    def _wait(self, due: float) -> bool:
        """Wait until a time, and return whether the run is interrupted."""
        while not self.is_interrupted and time.monotonic() < due:
            _sleep_until(due)
        return self.is_interrupted

    def _count(self, begin: float, due: float, start: float, age: float) -> None:
        """Record the times of a sample, and go on with the period that is running."""
        end = time.monotonic()
        self.times[self.samples % len(self.times)] = start - due, end - due, age
        self.samples += 1
        running = int(min((end - begin) / self.period, self.end))
        self.overruns += max(0, running - self.k)
        self.k = max(self.k + 1, running)

    def rollout(self) -> Rollout | None:
        """Return the recorded samples with their times."""
        if not len(self.stepper):
            return None
        rollout = self.stepper.rollout()
        order = np.arange(self.samples - len(rollout), self.samples) % len(self.times)
        times = {name: Signal("s", column) for name, column in zip(_TIMES, self.times[order].T, strict=True)}
        return replace(rollout, signals={**rollout.signals, **times})


def _check_measurement(value: object) -> Measurement:
    if not isinstance(value, tuple) or len(value) != 3:
        raise InvalidArgument(f"read returned {format_value(value)}, expected (t, q, v) or None")
    return value


def _sleep_until(due: float) -> None:
    """Sleep until a time of the monotonic clock, or a signal."""
    if _libc is None:
        time.sleep(max(0.0, due - time.monotonic()))
        return
    seconds = int(due)
    timespec = (ctypes.c_long * 2)(seconds, int(1e9 * (due - seconds)))
    _libc.clock_nanosleep(_CLOCK_MONOTONIC, _ABSOLUTE, timespec, None)


@contextmanager
def _fixed_priority(priority: int | None) -> Iterator[tuple[str, ...]]:
    """Give this thread a fixed priority, lock its memory, and restore both; yield what was done."""
    if priority is None or _libc is None:
        reason = "" if priority is None else ": the system is not Linux"
        yield (f"scheduling: as before{reason}",)
        return
    settings = os.sched_getscheduler(0), os.sched_getparam(0), _libc.prctl(_GET_SLACK, 0, 0, 0, 0)
    notes = [f"scheduling: SCHED_FIFO, priority {priority}", "memory: locked"]
    _libc.prctl(_SET_SLACK, 1, 0, 0, 0)  # before the scheduler, whose threads have no slack to set
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except OSError as error:
        notes[0] = (
            f"scheduling: as before, SCHED_FIFO failed ({error.strerror}): allow it by a line "
            f"'<user> - rtprio {priority}' in /etc/security/limits.conf"
        )
    is_locked = not _libc.mlockall(_CURRENT_AND_FUTURE)
    if not is_locked:
        notes[1] = (
            f"memory: not locked ({os.strerror(ctypes.get_errno())}): allow it by a line "
            "'<user> - memlock unlimited' in /etc/security/limits.conf"
        )
    try:
        yield tuple(notes)
    finally:
        if is_locked:
            _libc.munlockall()
        os.sched_setscheduler(0, settings[0], settings[1])
        _libc.prctl(_SET_SLACK, settings[2], 0, 0, 0)


@contextmanager
def _disable_collector() -> Iterator[None]:
    """Keep the garbage collector from running, which can take 40 ms."""
    collects, frozen = gc.isenabled(), gc.get_freeze_count()
    gc.collect()
    gc.freeze()
    gc.disable()
    try:
        yield
    finally:
        if not frozen:
            gc.unfreeze()
        if collects:
            gc.enable()


@contextmanager
def _handle_interrupt(periods: _Periods) -> Iterator[None]:
    """End the run after its period at the first Ctrl-C; a second one raises KeyboardInterrupt."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def interrupt(number: int, frame: FrameType | None) -> None:
        if periods.is_interrupted:
            raise KeyboardInterrupt
        periods.is_interrupted = True

    handler = signal.signal(signal.SIGINT, interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, signal.SIG_DFL if handler is None else handler)


def run_realtime(
    stepper: Stepper,
    read: Callable[[], Measurement | None],
    write: Callable[[Array], object],
    *,
    stop: Callable[[], object],
    rate: float | None = None,
    duration: float | None = None,
    stale: float = 0.1,
    limit: float = np.inf,
    priority: int | None = 50,
) -> RealtimeReport:
    """Run a controller at a fixed rate: read a measurement, compute a sample, write its input.

    Period k begins at the absolute time of k / rate after the first measurement. Its reference is sample k,
    and its input is due before the next period begins. A late sample counts as an overrun; periods that are
    over are left out. A period without a new measurement repeats the last one.

    The run ends after `duration`, if an error exceeds `limit`, if a measurement is older than `stale`, or at
    Ctrl-C. It always calls `stop`, also if `read` or `write` raises an error, which it raises again. The
    call follows a lost connection by at most `stale` and one period. The garbage collector is off during the
    run.

    Parameters
    ----------
    stepper : Stepper
        Controller with a trajectory. Its memory continues; its record begins anew.
    read : callable
        Function ``read()`` that returns the newest measurement ``(t, q, v)``, with the time `t` on the clock
        of `time.monotonic` [s], or None. It must not wait.
    write : callable
        Function ``write(u)`` that sends an input.
    stop : callable
        Function ``stop()`` that brings the robot to a safe state.
    rate : float, optional
        Samples per second, 1 / dt of the stepper [1/s].
    duration : float, optional
        Duration [s]; default: that of the trajectory. It may be infinite.
    stale : float
        Largest age of a measurement [s].
    limit : float
        Largest error of a coordinate or velocity [m, rad, m/s, rad/s]. The input of the sample beyond it is
        neither written nor recorded.
    priority : int or None
        Priority of SCHED_FIFO, 1 to 99. The run also locks its memory. The report states what the system
        does not allow. None leaves scheduling and memory as they are.

    Returns
    -------
    RealtimeReport
        Reason of the end, missed deadlines, jitter and recorded samples.

    Raises
    ------
    InvalidArgument
        If an argument or a measurement is invalid. After the start, `Stepper.rollout` has the samples before.
    NotFinite
        If an input is NaN or infinite.

    See Also
    --------
    realtime.Stepper : controller that computes one sample.
    simulate : the same loop with a simulated plant.

    Examples
    --------
    >>> import time
    >>> from pinmobile import PD, Circle, MobileRobot, Tangent
    >>> from pinmobile.realtime import Stepper, run_realtime
    >>> robot = MobileRobot(mass=30.0, yaw_inertia=1.3)
    >>> circle = Tangent(Circle(radius=1.0, rate=0.5, duration=0.2))
    >>> stepper = Stepper(PD(60, 60), robot, dt=0.02, trajectory=circle)
    >>> read = lambda: (time.monotonic(), [0, 0, 0], [0.5, 0, 0.5])
    >>> ends = []
    >>> report = run_realtime(stepper, read, ends.append,
    ...     stop=lambda: ends.append("stop"), priority=None)
    >>> report.reason, ends[-1]
    ('duration', 'stop')
    """
    instance("stepper", stepper, Stepper, "a Stepper")
    trajectory = required("stepper.trajectory", stepper.trajectory, "Stepper(..., trajectory=...)")
    callable_as("read()", read, "a function without arguments")
    callable_as("write(u)", write, "a function of u")
    callable_as("stop()", stop, "a function without arguments")
    period = stepper.dt
    if rate is not None and abs(positive("rate", rate, "Hz") * period - 1) > 1e-9:
        raise InvalidArgument(f"rate is {rate} Hz, expected 1 / dt of the stepper, {1 / period:g} Hz")
    total = trajectory.duration if duration is None else positive_or_endless("duration", duration, "s")
    end = np.inf if np.isinf(total) else max(1, round(total / period))
    bounds = positive("stale", stale, "s"), positive_or_endless("limit", limit)
    if priority is not None:
        check_integer("priority", priority, most=99)
    periods = _Periods(stepper, read, write, end, bounds)
    stepper.clear()
    with _fixed_priority(priority) as scheduling, _disable_collector(), _handle_interrupt(periods):
        try:
            reason, details = periods.run()
        except BaseException as error:
            error.add_note("stepper.rollout() returns the samples before")
            raise
        finally:
            stop()
    numbers = 1 / period, int(min(periods.k, end)), periods.overruns
    return RealtimeReport(reason, *numbers, periods.rollout(), scheduling, details)
