"""How a result was made is written in it, with the date that the camera wrote into its video."""

import shutil
from pathlib import Path

import av
import pytest

import posefuse as pf


def dated(source: Path, target: Path, stated: str) -> None:
    """The same packets in a file that states when it was recorded."""
    with av.open(str(source)) as read, av.open(str(target), "w") as written:
        written.metadata["creation_time"] = stated
        stream = written.add_stream_from_template(read.streams.video[0])
        for packet in read.demux(video=0):
            if packet.dts is not None:
                packet.stream = stream
                written.mux(packet)


@pytest.mark.parametrize("stated", ["2026-03-01T09:30:00Z", None])
def test_the_date_of_the_first_video_is_that_of_the_recording(demo_session: Path, tmp_path: Path, stated: str | None) -> None:
    session = Path(shutil.copytree(demo_session, tmp_path / "session"))
    if stated is not None:
        dated(demo_session / "videos" / "cam00.mp4", session / "videos" / "cam00.mp4", stated)
    truth = demo_session / "truth" / "truth.npz"
    oracle = {"detector.name": "oracle", "detector.options.truth": str(truth)}
    about = pf.track(session, end_s=0.2, settings=oracle).provenance
    assert about.get("recorded") == stated
    assert (about["session"], about["inputs"]["cam00"]) == ("session", "cam00.mp4")
    assert about["config"]["end_s"] == 0.2
