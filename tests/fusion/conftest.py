"""People in front of cameras, with exact truth."""

import built
import numpy as np
import pytest

from posefuse.core.skeleton import COCO17


@pytest.fixture(scope="session")
def standing() -> np.ndarray:
    """(17, 3) a coco17 person near the origin, facing +x, the right arm and leg ahead of the left ones."""
    xyz = built.standing()
    xyz[COCO17.indices(["right_elbow", "right_wrist", "right_knee"]), 0] += 0.15
    return xyz
