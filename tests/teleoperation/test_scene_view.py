"""What the Rerun view of teleoperation is given, read back by Rerun's own tool."""

import sys
from dataclasses import replace

import numpy as np
import pytest
from checks import refusal
from running import python

pytest.importorskip("rerun", reason="the extra `viewer` is not installed")

from bench.rehearsal.faults import engaged_world, tick
from bench.rehearsal.world import settings_for
from posefuse.core import DependencyError
from posefuse_teleop.scene_view import SceneView, _xyzw_from_z
from posefuse_teleop.settings import TeleoperationSettings


def test_operator_robot_box_and_keep_out_are_shown(tmp_path):
    settings = settings_for("point", roomy=False)
    settings = replace(settings, limits=replace(settings.limits, box_low_m=(0.0, -1.0, 0.1), box_high_m=(3.0, 1.0, 1.9)))
    world = engaged_world(settings, 0)
    view = SceneView(settings, str(tmp_path / "scene.rrd"))
    for _ in range(12):
        tick(world, set())
        view(world.operator, world.state and world.driver.follower.order)
    view.close()
    view.close()
    text = python("-m", "rerun", "rrd", "print", "-vvv", str(tmp_path / "scene.rrd")).stdout
    parts = ("operator/limbs", "operator/keep_out", "operator/hands", "robot/body", "robot/path", "robot/target", "workspace")
    assert [part for part in parts if f"/world/{part}" not in text] == []
    assert "ENGAGED" in text and "/separation_m" in text


def test_capsules_lie_along_their_bones():
    rng = np.random.default_rng(0)
    wanted = rng.normal(size=(20, 3))
    wanted = np.concatenate([wanted / np.linalg.norm(wanted, axis=1, keepdims=True), [[0, 0, 1.0], [0, 0, -1.0]]])
    x, y, z, w = _xyzw_from_z(wanted).T
    turned = np.stack([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x**2 + y**2)], axis=1)
    np.testing.assert_allclose(turned, wanted, atol=1e-6)


def test_without_rerun_it_names_the_extra(monkeypatch, tmp_path) -> None:
    monkeypatch.setitem(sys.modules, "rerun.blueprint", None)
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    refusal(DependencyError, r"posefuse\[viewer\]", SceneView, TeleoperationSettings(), str(tmp_path / "scene.rrd"))
