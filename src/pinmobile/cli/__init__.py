"""The `pinmobile` command: it reads options, calls the library, and prints the answer and what to do next."""

import os
import sys
import warnings
from collections.abc import Sequence
from contextlib import suppress
from io import UnsupportedOperation

from pinmobile.errors import InvalidArgument, PinmobileError

__all__ = ["main"]

_INTERRUPTED = 130  # as typer says it, and shells


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command.

    Parameters
    ----------
    arguments : sequence of str, optional
        Words after ``pinmobile``; by default those of the process.

    Returns
    -------
    code : int
        0: done; 1: done, and the answer is no (a route differs, a number is not the lecture's, a loop
        diverged), or the system failed, as of a full disk; 2: the options or files are not what is
        expected; 130: interrupted.
    """
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:  # closed, as by `>&-`: as with `>/dev/null`
            setattr(sys, name, os.fdopen(os.open(os.devnull, os.O_WRONLY), "w"))
    try:
        # It imports what it needs itself, so that an interrupt while that loads ends quietly.
        return _run(arguments)
    except KeyboardInterrupt:
        return _refuse("interrupted", _INTERRUPTED)


def _run(arguments: Sequence[str] | None) -> int:
    import typer

    from pinmobile.cli.verbs import app
    from pinmobile.errors import Diverged, FileError

    try:
        with warnings.catch_warnings():
            warnings.showwarning = _note
            words = sys.argv[1:] if arguments is None else arguments
            code = app(args=words or ["--help"], prog_name="pinmobile", standalone_mode=False)
        sys.stdout.flush()
    except typer.TyperException as error:
        return _refuse(
            f"{error.format_message()} ('pinmobile --help' or 'pinmobile COMMAND --help' tells more)"
        )
    except (Diverged, FileError) as error:
        return _refuse(str(error), 1)
    except InvalidArgument as error:
        return max(map(_refuse, str(error).splitlines() or [""]))
    except PinmobileError as error:
        return _refuse(str(error), _INTERRUPTED if str(error).startswith("interrupted") else 2)
    except typer.Abort:
        return _refuse("interrupted", _INTERRUPTED)
    except BrokenPipeError:
        # The reader has gone, as after `| head`; nothing is left to be said to it.
        _silence()
        return 0
    except OSError as error:
        # Files have errors of ours: this is what the console met, such as a full disk behind `>`.
        _silence()
        return _refuse(f"the output cannot be written: {error}", 1)
    return _refuse("interrupted", _INTERRUPTED) if code == _INTERRUPTED else int(code or 0)


def _silence() -> None:
    """Let what is left to be printed go nowhere, so that Python does not fail at its end."""
    with suppress(UnsupportedOperation):  # of an output that is no file
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _note(message: Warning | str, *where: object, **more: object) -> None:
    """Print a warning as one line: where in the library it came from is of no use here."""
    print(f"pinmobile: {' '.join(str(message).split())}", file=sys.stderr)


def _refuse(message: str, code: int = 2) -> int:
    print(f"pinmobile: {' '.join(message.split())}", file=sys.stderr)
    return code
