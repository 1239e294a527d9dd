"""From a log to parameters with intervals that hold, and motions that tell them."""

from pinmobile.identification.estimate import Identification, Prediction
from pinmobile.identification.log import Log
from pinmobile.identification.motions import Excitation, excitation
from pinmobile.identification.procedure import METHODS as METHODS, identify

__all__ = ["Excitation", "Identification", "Log", "Prediction", "excitation", "identify"]
