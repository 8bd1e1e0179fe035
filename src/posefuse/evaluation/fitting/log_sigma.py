"""Standard deviations that depend on the outputs of a network: log sigma is linear, with coefficients of maximum likelihood."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import minimize

from posefuse.core.arrays import Array


def fit_log_sigma(square: Array, design: Array, other_side: Sequence[int]) -> tuple[Array, Array]:
    """Offsets (n,) and weights (F,) of log sigma = offset + design . weights, for Gaussian errors of that sigma.

    Args:
        square: (M, n) squared errors per coordinate, in whatever unit sigma is to have, outliers limited.
        design: (M, n, F) features.
        other_side: (n,) place of each keypoint's mirror image: people are as good as those.
    """
    count = square.shape[1]

    def loss(parameters: Array) -> tuple[float, Array]:
        offset, weight = parameters[:count], parameters[count:]
        log_sigma = offset + design @ weight
        ratio = square * np.exp(-2 * log_sigma)
        slope = 1 - ratio
        gradient = np.concatenate([slope.mean(0), np.einsum("mk,mkf->f", slope, design) / len(square)])
        return float((log_sigma + ratio / 2).mean(0).sum()), gradient

    typical = 0.5 * np.log(np.maximum(square.mean(), 1e-12))
    start = np.concatenate([np.full(count, typical), np.zeros(design.shape[-1])])
    solved = minimize(loss, start, jac=True, method="L-BFGS-B", options={"maxiter": 2000})
    offset = solved.x[:count]
    return (offset + offset[list(other_side)]) / 2, solved.x[count:]
