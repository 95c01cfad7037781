"""What the core's observer takes: which points are pulled towards measured targets, and how hard."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np


@dataclass(frozen=True, eq=False)
class Observer:
    """Every carrier n gets sum_i G_ni share_i [stiffness e_i + damping de_i/dt], e_i = y_i - sum_k w_ik u_k;
    the targets y are a field, `target`, of the run.

    row_begin: (M + 1,), row_carrier, row_weight: the carriers of each of M channels and their weights w [-];
    reach_begin: (N + 1,), reach_channel, reach_weight: the channels that pull each of N carriers, and G [-],
    a number each or 3 x 3; reach_row: (N,) row of these of each carrier where several are pulled alike, -1
    where one is not pulled, empty: its own; stiffness: omega^2 [1/s^2]; damping: 2 zeta omega [1/s]; share:
    (F, M) of every output interval, 0 in gaps. Source: Luenberger, "Observing the state of a linear system",
    1964.
    """

    row_begin: np.ndarray
    row_carrier: np.ndarray
    row_weight: np.ndarray
    reach_begin: np.ndarray
    reach_channel: np.ndarray
    reach_weight: np.ndarray
    stiffness: float
    damping: float
    share: np.ndarray
    reach_row: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int32))

    def scaled(self, gain: float) -> Observer:
        """The same with all accelerations of e times `gain`, the damping ratio kept."""
        return replace(self, stiffness=self.stiffness * gain, damping=self.damping * gain**0.5)

    def as_dict(self) -> dict[str, object]:
        """As the core takes it."""
        return dict(vars(self))
