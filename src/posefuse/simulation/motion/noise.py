"""Smooth, never repeating wandering, the same for the same seed at any time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from posefuse.core.arrays import Array

_PARTIALS = 6


@dataclass(frozen=True, eq=False)
class Wander:
    """A sum of sines of random rates and phases with unit variance.

    Attributes:
        rate_hz, phase_rad: (_PARTIALS,).
    """

    rate_hz: Array
    phase_rad: Array

    @staticmethod
    def drawn(rng: np.random.Generator, slowest_hz: float, fastest_hz: float) -> Wander:
        """Rates spread evenly in logarithm between the two."""
        edges = np.linspace(np.log(slowest_hz), np.log(fastest_hz), _PARTIALS + 1)
        return Wander(np.exp(rng.uniform(edges[:-1], edges[1:])), rng.uniform(0, 2 * np.pi, _PARTIALS))

    def at(self, t_s: Array) -> Array:
        """Value (T,) at each time."""
        return np.asarray(np.sin(2 * np.pi * t_s[:, None] * self.rate_hz + self.phase_rad).sum(axis=1) / np.sqrt(_PARTIALS / 2))
