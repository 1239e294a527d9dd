"""From a log to parameters with intervals that hold."""

from pinmobile.identification.log import Log, Samples

__all__ = ["Log", "Samples"]
