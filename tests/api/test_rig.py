"""A rig in the hand triangulates what it projects."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
from checks import refusal

import posefuse as pf
from posefuse import core
from posefuse.api.values import rig_of
from posefuse.core import InputError


def test_it_finds_the_points_it_projected(ring_rig: Callable[..., core.Rig]) -> None:
    rig = rig_of(ring_rig(5))
    xyz = np.array([[0.1, -0.2, 1.0], [0.4, 0.3, 1.6], [-0.3, 0.2, 0.1]])
    found, cov, reproj = rig.triangulate(rig.project(xyz))
    np.testing.assert_allclose(found, xyz, atol=1e-9)
    assert cov.shape == (3, 3, 3)
    assert (reproj < 1e-6).all()


def test_what_is_made_of_it_stays_a_handle(demo_session: Path) -> None:
    rig = pf.read_rig(demo_session / "rig.toml")
    assert isinstance(rig.only(["cam02", "cam00"]), pf.Rig)
    assert "cam00" in repr(rig)


def test_it_is_saved_once_and_not_over_anything(demo_session: Path, tmp_path: Path) -> None:
    rig = pf.read_rig(demo_session / "rig.toml")
    assert pf.read_rig(rig.save(tmp_path / "rig.toml")).id == rig.id
    refusal(InputError, r"rig\.toml", rig.save, tmp_path / "rig.toml")
