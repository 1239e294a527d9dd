"""What is said where somebody stops a command that can go on."""

from pinmobile.errors import PinmobileError

__all__ = ["Interrupted"]


class Interrupted(PinmobileError):
    """A command was stopped; the message tells how it goes on."""
