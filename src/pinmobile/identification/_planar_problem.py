"""`PlanarProblem`: numbers of a planar model as output error estimates them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from pinmobile.arrays import Array
from pinmobile.identification._preprocessing import LATER
from pinmobile.identification._simulation import Segments, simulate

_STEP, _RUBBING_STEP = 5e-3, 1e-3  # [s], longest of an integration: friction changes its sign within some
_SHIFT = 1e-5  # of a parameter's scale, in differences
_LEAST_RESPONSE = 1e-3  # to an input, as a share of the largest
_RESPONSES = 3  # of a sensor, as the heading turns them


@dataclass(frozen=True, eq=False)
class PlanarProblem:
    """Numbers of a planar model that output error seeks: steps in some directions, and the delay.

    Parameters
    ----------
    model : PlanarModel
        The robot.
    base : ndarray, shape (p,)
        Where all steps are zero.
    basis : ndarray, shape (p, d)
        Directions, each of the size that is expected.
    delay : float
        By which poses come late, in samples.
    free : bool
        Whether the delay is sought too: then it is the last number.
    """

    model: Any
    base: Array
    basis: Array
    delay: float
    free: bool = False

    @property
    def start(self) -> Array:
        """The first numbers, shape (P,)."""
        return np.zeros(self.basis.shape[1] + self.free)

    def sizes(self, p: Array) -> Array:
        """Return the sizes of the numbers, shape (P,)."""
        return np.ones(len(p))

    def values(self, p: Array) -> tuple[Array, Array]:
        """Return parameters, shape (..., p), and delays, shape (...), of numbers (..., P)."""
        late = self.delay + (p[..., -1] if self.free else np.zeros(p.shape[:-1]))
        return self.base + p[..., : self.basis.shape[1]] @ self.basis.T, late

    def is_possible(self, p: Array) -> bool:
        """Return whether there is a body of such numbers, about as late as at first."""
        phi, late = self.values(p)
        return bool(self.model.are_possible(phi) and abs(late - self.delay) < LATER)

    @property
    def rates(self) -> Callable[..., Any]:
        """Law of one state."""
        return self.model.rates  # type: ignore[no-any-return]

    def increments(self, p: Array) -> Array:
        """Return the steps of differences: a whole sample of the delay."""
        return np.append(np.full(self.basis.shape[1], _SHIFT), [1.0] * self.free)

    def resolved(self, segments: Segments, p: Array) -> tuple[Array, Array, float]:
        """Return the parameters with known loads, delays and the longest time step."""
        phi, late = self.values(p)
        body = np.repeat(phi[:, None], len(segments.y), axis=1)
        body[..., :4] += segments.load
        rubs = any(each.coulomb or each.efficiency < 1 for each in self.model.motors)
        return body, late, _RUBBING_STEP if rubs else _STEP

    def observed(self, segments: Segments, states: Array) -> Array:
        """Return the poses, and rates of wheels where they are measured."""
        if segments.y.shape[-1] == 3:
            return states[..., :3]
        return np.concatenate([states[..., :3], states[..., 3:] @ self.model.A.T], axis=-1)

    def responses(self, segments: Segments, p: Array, starts: Array) -> Array:
        """Return the sensors' responses to inputs that are held for the first step, shape (r, L, m).

        Of a robot at rest without dry friction; of all headings and inputs, the few that have most of it.
        """
        (phi, late), resting = self.values(p), starts.copy()
        resting[:, 3:], phi[self.model.dry], phi[self.model.offsets] = 0.0, 0.0, 0.0
        still, found = PlanarProblem(self.model, phi, self.basis[:, :0], float(late)), []
        column = segments.lead - int(np.floor(late))
        for unit in np.diag(segments.sizes):
            held = np.zeros((*segments.at.shape, segments.inputs.shape[1]))
            held[:, column] = unit
            at = np.arange(held[..., 0].size).reshape(segments.at.shape)
            there = segments._replace(inputs=held.reshape(-1, held.shape[-1]), at=at)
            out = simulate(still, there, np.zeros((1, 0)), resting[None])[0] / segments.noise[:, None]
            found.append(out - out[:, :1])
        _, sizes, rows = np.linalg.svd(np.moveaxis(np.concatenate(found), -1, 0), full_matrices=False)
        sizes = np.where(sizes > _LEAST_RESPONSE * sizes[:, :1], sizes, 0.0)
        return np.asarray(np.moveaxis((sizes[..., None] * rows)[:, :_RESPONSES], 0, -1))
