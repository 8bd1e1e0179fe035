"""The figure of `support/figure.py`."""

from collections.abc import Callable

import figure
import pytest

from posefuse.core import PoseSequence


@pytest.fixture(scope="session")
def posed() -> Callable[..., PoseSequence]:
    """Builder of a PoseSequence out of one dict of angles per time step."""
    return figure.sequence_of
