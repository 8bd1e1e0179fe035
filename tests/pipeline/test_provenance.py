"""How a result was made is written in it, with the date that the camera wrote into its video."""

import shutil
from pathlib import Path

import pytest
from commands import oracle
from videos import remuxed

import posefuse as pf


@pytest.mark.parametrize("stated", ["2026-03-01T09:30:00Z", None])
def test_the_date_of_the_first_video_is_that_of_the_recording(demo_session: Path, tmp_path: Path, stated: str | None) -> None:
    session = Path(shutil.copytree(demo_session, tmp_path / "session"))
    if stated is not None:
        remuxed(demo_session / "videos" / "cam00.mp4", session / "videos" / "cam00.mp4", stated=stated)
    about = pf.track(session, end_s=0.2, settings=oracle()).provenance
    assert about.get("recorded") == stated
    assert (about["session"], about["inputs"]["cam00"]) == ("session", "cam00.mp4")
    assert about["config"]["end_s"] == 0.2
