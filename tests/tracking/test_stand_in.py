"""The person whom the pipeline processes beforehand is taken for one, however few the cameras."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from posefuse.association import AssociateSettings, associate
from posefuse.core.skeleton import SKELETONS
from posefuse.formats.rig import read_rig
from posefuse.tracking.stand_in import made_up_detections

RIG = read_rig(Path(__file__).resolve().parents[2] / "examples" / "demo" / "rig.toml")


@pytest.mark.parametrize("cameras", [2, 4])
@pytest.mark.parametrize("skeleton", ["coco17", "body_25", "blazepose33", "halpe_26", "coco_wholebody_133"])
def test_the_made_up_person_is_found_by_two_cameras_and_by_four(skeleton: str, cameras: int) -> None:
    rig = RIG.only(RIG.names[:cameras])
    # in the second time step the first camera contradicts the others, which two cameras do not survive
    for views in list(made_up_detections(rig, SKELETONS[skeleton], 5))[:: 2 if cameras == 2 else 1]:
        together = [replace(view, t_ns=0) for view in views]
        assert np.array_equal(associate(together, rig, AssociateSettings(), None).person_id, [0])
