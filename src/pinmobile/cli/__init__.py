"""The ``pinmobile`` command: it reads options, calls the library, and prints the result and the next step."""

import os
import signal
import sys
import threading
import warnings
from collections.abc import Sequence
from contextlib import suppress
from io import UnsupportedOperation

from pinmobile.errors import PinmobileError

__all__ = ["main"]

_INTERRUPTED = 130  # exit code of typer and shells


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command ``pinmobile``.

    Parameters
    ----------
    arguments : sequence of str, optional
        Words after ``pinmobile``; default: the arguments of the process.

    Returns
    -------
    code : int
        0: done. 1: a check failed, a run diverged, or the system failed, for example because the disk is
        full or a cluster is lost. 2: options or files are invalid. 130: interrupted.

    Examples
    --------
    >>> from pinmobile.cli import main
    >>> main(["--version"])
    pinmobile ...
    0
    """
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:  # closed, as by `>&-`: use /dev/null
            setattr(sys, name, os.fdopen(os.open(os.devnull, os.O_WRONLY), "w"))
    is_main = threading.current_thread() is threading.main_thread()
    try:
        # SIGTERM, as of a batch system, ends in order like Ctrl-C: without temporary files.
        before = signal.signal(signal.SIGTERM, signal.default_int_handler) if is_main else None
        # _run imports its modules itself, so that an interrupt during an import ends quietly.
        return _run(arguments)
    except KeyboardInterrupt:
        return _print_error("interrupted", _INTERRUPTED)
    finally:
        if is_main:
            signal.signal(signal.SIGTERM, before or signal.SIG_DFL)


def _run(arguments: Sequence[str] | None) -> int:
    import typer

    from pinmobile.cli.verbs import TASKS, app
    from pinmobile.errors import Diverged, FileError, SchedulerError

    words = list(sys.argv[1:] if arguments is None else arguments) or ["--help"]
    pages = {verb: page for verbs in TASKS.values() for verb, page in verbs.items()}

    def reject(text: str) -> int:
        """Print what is wrong, a line each, and the page of the verb."""
        page = pages.get(words[0], "howto/headless")
        return max(map(_print_error, [*text.splitlines(), f"page of the documentation: {page}"]))

    try:
        with warnings.catch_warnings():
            warnings.showwarning = _print_warning
            code = app(args=words, prog_name="pinmobile", standalone_mode=False)
        sys.stdout.flush()
    except typer.TyperException as error:
        return reject(f"{error.format_message()} (see 'pinmobile --help' or 'pinmobile COMMAND --help')")
    except (Diverged, FileError, SchedulerError) as error:
        return _print_error(str(error), 1)
    except PinmobileError as error:
        text = str(error)
        return _print_error(text, _INTERRUPTED) if text.startswith("interrupted") else reject(text)
    except typer.Abort:
        return _print_error("interrupted", _INTERRUPTED)
    except BrokenPipeError:
        # The reader has closed the pipe, for example `| head`.
        _discard_output()
        return 0
    except OSError as error:
        # Errors of files are FileError: this one is about the console, such as a full disk behind `>`.
        _discard_output()
        return _print_error(f"the output cannot be written: {error}", 1)
    return _print_error("interrupted", _INTERRUPTED) if code == _INTERRUPTED else int(code or 0)


def _discard_output() -> None:
    """Discard the remaining output, so that Python does not fail at its end."""
    with suppress(UnsupportedOperation):  # the output is not a file
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _print_warning(message: Warning | str, *_args: object, **_options: object) -> None:
    """Print a warning as one line, without its place in the library."""
    print(f"pinmobile: {' '.join(str(message).split())}", file=sys.stderr)


def _print_error(message: str, code: int = 2) -> int:
    print(f"pinmobile: {' '.join(message.split())}", file=sys.stderr)
    return code
