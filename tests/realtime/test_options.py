"""Options of `posefuse live` go through the same validation as the settings file."""

import pytest

from posefuse.cli import main as cli


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--output", "nothing"), "no plug-in 'nothing' among live_outputs; there are: "),
        (("--output", "osc"), "live_outputs osc: to: missing"),
        (("--output", "lsl", "--set", "outputs.lsl.speed=3"), "unknown key 'speed'"),
        (("--set", "outputs.osc.to=[]"), "to:"),
        *((("--people", text), "--people") for text in ("0", "-1", "65")),
        *((("--duration", text), "duration_s") for text in ("nan", "-5", "0", "inf")),
        *((("--loop", text), "loop_s") for text in ("nan", "0", "-1", "inf")),
        (("--osc", "127.0.0.1:9", "--set", "outputs.osc.axes=sideways"), "axes"),
        (("--record", "walk.mp4"), "walk.mp4: expected a name that ends in .mcap"),
        (("--osc", "nonsense"), "host:port"),
        (("--record", "/nowhere/x.mcap"), "there is no folder /nowhere"),
        (("--record-images",), "live_outputs record: path: missing"),
        (("--axes", "y_up"), "no output of this session has axes"),
        (("--domain", "5"), "--domain 5: no source and no output is in ROS 2; leave it out, or add one"),
        (("--peer", "10.0.0.7", "--peer", "10.0.0.8", "--record", "walk.mcap"), "--peer 10.0.0.7 10.0.0.8: no source"),
        (("--local-only", "--osc", "127.0.0.1:9"), "--local-only: no source"),
        (("--sim-time",), "--sim-time: no source"),
        (("--record", "walk"), "walk: expected a name that ends in .mcap"),
        (("--record", "walk.mcap", "--videos", "walk.mcap"), "the folder of --videos"),
        (("--record", "kept/walk.mcap", "--videos", "kept"), "the folder of --videos"),
        (("--record", "earlier/a.2.mcap"), "by its name it is a later part of a.mcap"),
        (("--record", "earlier/b.mcap"), "by its name, b.3.mcap is a later part of it"),
        (("--source", "cam00=video:"), "expected where it is after video:"),
        ((), "expected sources for at least 2 cameras, got 0"),
    ],
)
def test_what_cannot_be_is_one_line_before_anything_starts_or_a_network_is_fetched(
    options: tuple[str, ...], words: str, demo_session, tmp_path, monkeypatch, capsys
) -> None:
    monkeypatch.setattr("posefuse.api.live_run.fetch_networks", lambda *_: pytest.fail("networks were fetched"))
    monkeypatch.chdir(tmp_path)
    kept = [tmp_path / name for name in ("kept", "earlier", "earlier/a.mcap", "earlier/b.3.mcap")]
    for place in kept:
        place.touch() if place.suffix else place.mkdir()
    source = () if not options or options[0] == "--source" else ("--source", f"sim:{demo_session}")
    assert cli.main(["live", str(demo_session / "rig.toml"), *source, *options]) == 1
    out, err = capsys.readouterr()
    assert out == "" and words in err
    assert err.count("\n") == 1 and "Traceback" not in err
    assert sorted(tmp_path.rglob("*")) == sorted(kept)


def test_where_ros_2_is_has_no_effect_on_a_recording_without_its_topics(demo_session, tmp_path, capsys) -> None:
    assert cli.main(["record", "--source", f"sim:{demo_session}", "--out", str(tmp_path / "new"), "--domain", "5"]) == 1
    assert "--domain 5: no source and no output is in ROS 2" in capsys.readouterr().err and not (tmp_path / "new").exists()
