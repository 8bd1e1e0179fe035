"""Information of the rays of one time step about segment lengths, with the pose re-fitted to them."""

from __future__ import annotations

import numpy as np

from posefuse.foundation.compiled import kernel

from .measurements import ray_information


@kernel()
def length_information(
    points, by_state, by_length, projections, xy, inverse_var, robust, information, out_information, out_slope
):
    """Add to the normal equations of the lengths, (S, S) and (S,), with the state (D) eliminated.

    points (A, 3) at the optimum of the state, whose information (D, D) that is; derivatives by_state (A, 3, D) and by_length
    (A, 3, S); rays as for `ray_information`.
    """
    size, lengths = by_state.shape[2], by_length.shape[2]
    mixed = np.zeros((lengths, size))
    own = np.zeros((lengths, lengths))
    gradient = np.empty(3)
    local = np.empty((3, 3))
    for p in range(points.shape[0]):
        gradient[:] = 0.0
        local[:] = 0.0
        ray_information(points[p], projections, xy[p], inverse_var[p], robust, gradient, local)
        pulled = by_length[p].T.copy() @ local
        own += pulled @ by_length[p]
        mixed += pulled @ by_state[p]
        for s in range(lengths):
            for i in range(3):
                out_slope[s] += by_length[p, i, s] * gradient[i]
    out_information += own - mixed @ np.linalg.solve(information, mixed.T.copy())
