"""`Setting`: what all stages of an identification need, and which directions of parameters a motion tells."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from pinmobile.arrays import Array
from pinmobile.errors import InvalidArgument
from pinmobile.identification.chassis import Chassis
from pinmobile.identification.cleaning import Cleaned
from pinmobile.identification.weak_form import Rows

_SEEN = 0.01  # share of its force that a direction must have to be seen
_LEVER = 0.25  # [m], of a robot whose size is not known


class Setting(NamedTuple):
    """What all stages need.

    Attributes
    ----------
    logs : list of Cleaned
        The logs.
    rows : list of Rows
        Their weak forms.
    chassis : Chassis
        The robot.
    scales : ndarray, shape (p,)
        Sizes that the parameters may be expected to have.
    prior : ndarray, shape (p,), or None
        What is believed.
    """

    logs: list[Cleaned]
    rows: list[Rows]
    chassis: Chassis
    scales: Array
    prior: Array | None

    @classmethod
    def of(cls, logs: list[Cleaned], rows: list[Rows], chassis: Chassis, prior: Array | None) -> Setting:
        """Return the setting of logs.

        Raises
        ------
        InvalidArgument
            If hardly anything moves.
        """
        return cls(logs, rows, chassis, _scales(logs, rows, chassis), prior)

    def directions(self) -> tuple[Array, Array]:
        """Return orthonormal directions that the motion tells, and those left unseen, in the scales.

        Seen is what has more than a hundredth of the forces in the weak form's regressor, the part left out
        that the noise of poses makes: a second draw of it tells how much that is.
        """
        chassis, gram, count = self.chassis, 0.0, 0
        scales = self.scales[: len(self.scales) - chassis.scaled]
        per_row = self._row_sizes()
        for part in self.rows:
            regressor, shaken = part.regressors(chassis)
            Y, N = (each * scales / per_row[:, None] for each in (regressor, shaken[0] - regressor))
            gram = gram + np.einsum("nki,nkj->ij", Y, Y) - 1.5 * np.einsum("dnki,dnkj->ij", N, N) / len(N)
            count += Y.shape[0] * Y.shape[1]
        values, vectors = np.linalg.eigh(np.asarray(gram) / count)
        told = values > _SEEN**2
        seen, unseen = vectors[:, told], vectors[:, ~told]
        if not chassis.scaled:
            return seen, unseen
        # The scale is seen where all else is, as loads differ.
        extended = np.zeros((len(self.scales), seen.shape[1] + 1))
        extended[:-1, :-1], extended[-1, -1] = seen, 1.0
        return extended, np.vstack([unseen, np.zeros(unseen.shape[1])])

    def _row_sizes(self) -> Array:
        """Return of which size rows of forces are, shape (k,)."""
        forces = np.concatenate([one.forces(self.chassis, 0.0) for one in self.rows])
        size = np.sqrt((forces**2).mean(axis=0))
        force = max(np.hypot(*size[:2]) if self.chassis.free == 3 else size[0], 4 * size[-1])
        return np.array([*[force] * (self.chassis.free - 1), max(size[-1], force * _LEVER)])


def _scales(logs: Sequence[Cleaned], rows: Sequence[Rows], chassis: Chassis) -> Array:
    """Return the size that each parameter has if it alone were behind the forces, by their power."""
    twist = np.concatenate([one.twist for one in logs])
    turned = np.concatenate([np.gradient(one.twist, one.dt, axis=0) for one in logs])
    forces = np.concatenate([one.forces(chassis, 0.0) for one in rows])
    wrench = forces @ (np.eye(3) if chassis.B is None else np.linalg.pinv(chassis.S))
    f, moment = np.sqrt((wrench[:, :2] ** 2).sum(axis=1).mean()), np.sqrt((wrench[:, 2] ** 2).mean())
    noise = np.max([one.noise for one in logs], axis=0)
    speed, rate = np.sqrt((twist[:, :2] ** 2).sum(axis=1).mean()), np.sqrt((twist[:, 2] ** 2).mean())
    moved = np.ptp(np.concatenate([one.q for one in logs]), axis=0)
    if not (moved > 20 * noise).any() or not max(f, moment) > 0:
        raise InvalidArgument(
            f"log has poses that move by {moved[0]:.3g} m, {moved[1]:.3g} m and {moved[2]:.3g} rad, and "
            f"forces of {f:.3g} N and {moment:.3g} N m, too little to tell anything: expected a motion that "
            "excites, see excitation"
        )
    r = twist[:, 2]
    across = turned[:, 0] - r * twist[:, 1], turned[:, 1] + r * twist[:, 0]
    acceleration = np.sqrt((across[0] ** 2 + across[1] ** 2).mean())
    force = max(f, moment / _LEVER / 4)
    mass = force / max(acceleration, 1e-3)
    power = force * speed + max(moment, 0.0) * rate
    if chassis.wheels:
        rates = np.sqrt(((twist @ np.linalg.pinv(chassis.S).T @ chassis.A.T) ** 2).mean())
        per_rate = np.full(len(chassis.A), rates)
    else:
        per_rate = np.array([speed, speed, max(rate, speed)])
    scale = np.ones(1)[: int(chassis.scaled)]
    body = mass * np.array([1.0, _LEVER, _LEVER, _LEVER**2])
    dry = power / per_rate
    return np.concatenate([body, power / per_rate**2, dry, dry[: len(dry) * chassis.offset], scale])


def in_words(chassis: Chassis, unseen: Array) -> str:
    """Return what directions of the parameters are unseen, in words."""
    names = [one.name for one in chassis.quantities]
    hidden = unseen @ unseen.T
    alone = [names[k] for k in range(len(names)) if hidden[k, k] > 0.98]
    mixed = [k for k in range(len(names)) if 0.02 < hidden[k, k] <= 0.98]
    groups: list[list[int]] = []
    for k in mixed:
        near = [g for g in groups if any(abs(hidden[k, j]) > 0.05 for j in g)]
        groups = [g for g in groups if g not in near] + [[j for g in near for j in g] + [k]]
    told = [f"the motion does not tell {', '.join(alone)}"] if alone else []
    told += [f"of {', '.join(names[j] for j in sorted(g))} it tells combinations alone" for g in groups]
    return "; ".join(told)
