"""A path driven with the heading held."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from pinmobile.arrays import ArrayLike, scalar
from pinmobile.paths import Path, within
from pinmobile.plant import Parameter
from pinmobile.trajectories.reference import Reference, joined, plane_path

__all__ = ["FixedHeading"]


@dataclass(frozen=True)
class FixedHeading:
    """Along a path with one heading throughout: a holonomic robot can.

    Parameters
    ----------
    path : Path
        A path of two coordinates.
    psi : float
        The heading [rad].

    Raises
    ------
    InvalidArgument
        If `path` is no path in the plane, or `psi` not one finite number.
    """

    path: Path
    psi: float

    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("fixed_heading", "rad", "heading that is held", attribute="psi"),
    )

    def __post_init__(self) -> None:
        plane_path(self.path)
        object.__setattr__(self, "psi", scalar("psi", self.psi))

    @property
    def duration(self) -> float:
        """The path's duration [s]."""
        return float(self.path.duration)

    def __call__(self, t: ArrayLike) -> Reference:
        """Return the reference.

        Parameters
        ----------
        t : array_like, shape (...)
            Times, 0 <= t <= duration [s].

        Returns
        -------
        reference : Reference
            Arrays of shape (..., 3); the heading's derivatives are zero.

        Raises
        ------
        InvalidArgument
            If a time is outside.
        """
        times = within("t", t, self.duration)
        still = np.zeros(times.shape)
        return joined(
            (self.path.derivative(times, order) for order in range(3)), (still + self.psi, still, still)
        )
