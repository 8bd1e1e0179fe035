"""From images to a result with networks that really see: discs of one colour per keypoint, through the whole `posefuse track`."""

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from posefuse.cli.main import main
from posefuse.core import SKELETONS, Frame, Region, Rig
from posefuse.detection.networks import OnnxConfig
from posefuse.evaluation.contracts import check_detector
from posefuse.formats.recording import read_recording
from posefuse.formats.rig import write_rig
from posefuse.sources import ImagesConfig

discs = pytest.importorskip("discs", reason="the package onnx is not installed")
KINDS = ["simcc", "heatmap", "synthpose", "rtmo", "yolo_pose"]


@pytest.fixture(scope="module")
def session(ring_rig: Callable[..., Rig], tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("discs")
    rig = ring_rig(4, size_wh=(720, 560))
    discs.draw(rig, discs.true_xyz(), folder / "images")
    write_rig(folder / "rig.toml", rig)
    (folder / "posefuse.toml").write_text(f"rate_hz = {discs.RATE_HZ}\njoint_centres = false\n")
    return folder


@pytest.mark.parametrize("kind", KINDS)
def test_the_person_is_where_the_discs_are(kind: str, session: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    options = ["--networks", str(discs.card_of(kind, tmp_path)), "--outputs", "trc", "--raw", "--json"]
    assert main(["track", str(session), "--out", str(out), *options]) == 0
    figures = json.loads(capsys.readouterr().out)
    assert {one["seen"] for one in figures["camera_fits"].values()} == {1.0}
    recording = read_recording(out)
    skeleton = SKELETONS["synthpose_52"] if kind == "synthpose" else discs.SKELETON
    assert recording.poses.skeleton == skeleton and recording.poses.xyz_world.shape == (discs.FRAMES, 1, len(skeleton), 3)
    exact = discs.true_xyz()[:, np.arange(len(skeleton)) % len(discs.SKELETON)]
    off_mm = 1000 * np.linalg.norm(recording.poses.xyz_world[:, 0] - exact, axis=-1)
    assert np.nanmedian(off_mm) < 2.0 and np.nanpercentile(off_mm, 95) < 8.0
    assert np.isfinite(off_mm).mean() > 0.97


@pytest.mark.parametrize("kind", KINDS)
def test_the_plug_in_keeps_the_contract(kind: str, session: Path, tmp_path: Path) -> None:
    frames = [next(ImagesConfig(session / "images" / name, name, discs.RATE_HZ).build().frames()) for name in ("cam00", "cam02")]
    no_person = replace(frames[0], image=np.zeros_like(frames[0].image))
    check_detector(OnnxConfig(card=str(discs.card_of(kind, tmp_path)), streams=1).build(), [*frames, no_person])


class Closer:
    """Finds the first region in the whole image, and all of them, one twice, in its closer squares."""

    def __init__(self, regions: list[Region]) -> None:
        self._regions = regions

    def stages(self, size_wh: tuple[int, int], up_rad: float) -> Iterator[list[Region]]:
        whole = Region(centre_img=np.array(size_wh) / 2, side_px=float(max(size_wh)), angle_rad=up_rad)
        yield from ([whole], [whole, whole])

    def people(self, looks: Sequence[tuple[Frame, Sequence[Region]]]) -> list[list[Region]]:
        return [self._regions[:1] if len(squares) == 1 else [self._regions[0], *self._regions] for _, squares in looks]


def test_people_are_found_however_many_and_in_whichever_stage(session: Path, tmp_path: Path) -> None:
    """A network of a card ended with the first stage in which there was a person, and with the fourth person."""
    detector = OnnxConfig(card=str(discs.card_of("simcc", tmp_path)), streams=1).build()
    one = next(ImagesConfig(session / "images" / "cam00", "cam00", discs.RATE_HZ).build().frames())
    crowd = replace(one, image=np.hstack([one.image] * 6))
    places = [(i + 0.5) * one.size_wh[0] for i in range(6)]
    height = one.size_wh[1]
    detector._finder = Closer(
        [Region(centre_img=np.array([x, height / 2]), side_px=float(height), angle_rad=0.0) for x in places]
    )
    [found] = detector.detect([crowd], [None])
    assert np.sort(np.nanmean(found.xy_img[..., 0], axis=1) // one.size_wh[0]).tolist() == [0, 1, 2, 3, 4, 5]
