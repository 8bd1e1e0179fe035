"""The command line as values: every option that posefuse ever had is understood, and what is wrong is one line with the remedy.

The table was made from the help of the commands before they were derived from typed functions.
"""

import re
import subprocess
import sys
from functools import cache

import pytest

from posefuse.cli.command_line import COMMANDS, GROUPS, STEPS, Invocation, WrongCommandLineError, application, parse
from posefuse.cli.main import main

TARGET = (
    "--target charuco, --columns 5, --rows 7, --square-mm 50, --marker-mm 40, --thickness-mm 5, --dictionary text, "
    "--ids 1,2,3, --inverted, --legacy"
)
SETTINGS = "--config text, --set one --set two, --networks one"
LIVE = "--people 2, --names A, --body on, --rate 50, --groups 2, --camera-info use"
ROS_2 = "--domain 3, --peer one --peer two, --interface text, --local-only, --sim-time"
OUTPUTS = (
    "--record text, --record-images, --ros, --ros1, --osc one --osc two, --json-udp one --json-udp two, "
    "--output one --output two, --axes y_up_left_handed, --view, --view-file text, --report text"
)
# command with its arguments: the options it needs, and all others, each with a value that is not the default
ACCEPTED = {
    "demo": (
        "",
        "--json, --out text, --force",
    ),
    "track SESSION": (
        "--out text",
        "--json, --force, --resume, --rig text, --input pose2d, --weights robust, --raw, --body on, --people 2, "
        "--names A,B, --refine-rig, --person -1.1,0, "
        "--start 1, --end 2, --outputs text, --view, --rate 50, "
        f"{SETTINGS}",
    ),
    "solve RESULT": (
        "--out text",
        "--json, --force, --weights robust, --raw, --body on, --people 2, --names A,B, --refine-rig, --person -1.1,0, "
        "--exclude cam0:1-2 --exclude 3-4.5, --keep-person 1, --no-edits, "
        "--start 1, --end 2, --outputs text, --view, --rate 50, --config text, --set one --set two",
    ),
    "record": (
        "--source one --out text",
        f"--json, --rig text, --duration 5, --resume, {ROS_2}",
    ),
    "live rig.toml": (
        "",
        f"--json, --source one --source two, --duration 5, --loop 5, --videos text, {SETTINGS}, {LIVE}, {ROS_2}, {OUTPUTS}",
    ),
    "calibrate intrinsics a=a.mp4 b=b.mp4": (
        "--out text --target a.toml",
        "--every 2, --json, --force, --report text",
    ),
    "calibrate extrinsics a=a.mp4 b=b.mp4": (
        "--out text --target a.toml",
        "--intrinsics text, --every 2, --clocks drift, --floor-marker 7, --floor-side-mm 80, --floor-points text, --any-size, "
        "--keep-refused, "
        "--refine-lenses 0.5, --upside-down one --upside-down two, --json, --force, --report text",
    ),
    "calibrate guide": (
        "--source one --source two --target a.toml",
        f"--intrinsics text, --record text, --duration 5, --json, {ROS_2}",
    ),
    "calibrate person a=a.mp4 b=b.mp4": (
        "--intrinsics text --out text",
        "--height-m 1.8, --apart a b 2.5, --rate 30, --clocks drift, --most-s 2, "
        "--upside-down one --upside-down two, "
        "--networks one, --json, --force, --report text",
    ),
    "calibrate clocks SESSION": (
        "",
        "--rig text, --input pose2d, --clocks drift, --rate 30, --seconds 20, --most-s 2, --networks one, "
        "--json, --force, --report text",
    ),
    "calibrate verify a=a.mp4 b=b.mp4": (
        "--rig text --target a.toml",
        "--every 2, --offset-ms one --offset-ms two, --json, --force, --report text",
    ),
    "calibrate print": (
        "--out text",
        f"--cube, --page text, --json, --force, {TARGET}",
    ),
    "studio WORKSPACE": (
        "",
        "--json, --port 9000, --host localhost, --token text, --no-open",
    ),
    "view RESULT": (
        "",
        "--json, --session text",
    ),
    "report RESULT": (
        "",
        "--json, --out text, --fit rays, --opensim, --opensim-model text, --title text",
    ),
    "export RESULT": (
        "--out text",
        "--json, --outputs text, --session text",
    ),
    "batch STUDY": (
        "--out text",
        "--config text, --force, --jobs 2, --json, --networks one, --no-report, --outputs text, --scheduler text, "
        "--set one --set two",
    ),
    "simulate scene.yaml": (
        "",
        "--json, --force, --workers 2, --out text, --plan, --gazebo text, --for jetty",
    ),
    "teleoperate rig.toml": (
        "",
        "--json, --source one --source two, --duration 5, --loop 5, --hand left, --deadman gesture, "
        "--scale 2, --turn 90, --orientation forearm, --i-have-an-emergency-stop, --robot text, --frame one --frame two, "
        "--robot-at 1,2,90, --elsewhere, --box 0,0,0,1,2,3, --speed 0.2, --limits text, --view, --view-scene, --view-file text, "
        "--record text, --ros, --ros1, "
        f"--command twist, --base-frame text, --controller text, --cmd-vel text, --cmd-vel-twist, {SETTINGS}, {LIVE}, {ROS_2}",
    ),
    "compare a.trc b.trc": (
        "",
        "--json, --out text, --person 1, --scale, --no-time, --no-space, --align-first 3",
    ),
    "models m": (
        "",
        "--json, --check, --from text",
    ),
    "plugins": (
        "",
        "--json",
    ),
    "doctor": (
        "",
        "--json",
    ),
    "node camera rig.toml": (
        "",
        f"--json, --source one --source two, --name text, --duration 5, --loop 5, {SETTINGS}, {LIVE}, {ROS_2}",
    ),
    "node fusion rig.toml": (
        "",
        f"--json, --duration 5, --loop 5, {SETTINGS}, {LIVE}, {ROS_2}, {OUTPUTS}",
    ),
    "fit-noise card.toml": (
        "--scenes-in text",
        "--json, --scenes 3, --moving 4, --device cuda",
    ),
}

EVERY = [(command, needed, option) for command, (needed, options) in ACCEPTED.items() for option in options.split(", ")]
PLACES = [*COMMANDS, *(f"{command} {step}" for command, steps in STEPS.items() for step in steps)]


@cache
def parsed(*texts: str) -> Invocation:
    found = parse([word for text in texts for word in text.split()])
    assert found is not None
    return found


@pytest.mark.parametrize(("command", "needed", "option"), EVERY, ids=[f"{one[0]} {one[2]}" for one in EVERY])
def test_every_option_is_understood_and_changes_something(command: str, needed: str, option: str) -> None:
    without, found = parsed(command, needed), parsed(command, needed, option)
    assert found.words == without.words == tuple(command.split())[: len(found.words)]
    assert (found.bound != without.bound) != (found.as_json != without.as_json)
    if option == "--json":
        assert found.as_json


def test_an_option_that_changes_nothing_would_be_found() -> None:
    assert parsed("track SESSION --out text").bound == parsed("track SESSION --out text").bound
    assert parsed("track SESSION --out text").bound != parsed("track SESSION --out other").bound


@pytest.mark.parametrize(("command", "needed"), [(command, needed) for command, (needed, _) in ACCEPTED.items() if needed])
def test_what_a_command_needs_is_named(command: str, needed: str) -> None:
    with pytest.raises(WrongCommandLineError, match=r"missing --[a-z-]+; see posefuse") as wrong:
        parsed(command)
    assert re.search(r"missing (--[a-z-]+)", str(wrong.value))[1] in needed


@pytest.mark.parametrize("words", ["--json calibrate clocks S", "calibrate --json clocks S", "calibrate clocks --json S"])
def test_json_stands_anywhere(words: str) -> None:
    found = parsed(words)
    assert found.as_json and found.words == ("calibrate", "clocks")


@pytest.mark.parametrize("words", ["--person -1.1,0", "--person=-1.1,0"])
def test_a_place_may_begin_with_a_minus(words: str) -> None:
    assert parsed("track S --out R", words).bound.arguments["options"].changes == {"associate.near_xy_m": (-1.1, 0.0)}


def test_options_that_are_repeated_are_all_kept() -> None:
    found = parsed("live rig.toml --source a=usb:0 --source b=usb:1 --peer one --set a=1 --peer two --set b=2").bound.arguments
    assert found["sources"].source == ("a=usb:0", "b=usb:1")
    assert found["ros_2"].peer == ("one", "two")
    assert found["settings"].changes == {"a": 1, "b": 2}


@pytest.mark.parametrize(
    ("words", "line"),
    [
        ("trac", "posefuse: unknown command 'trac'; did you mean track?; see posefuse --help"),
        ("calibrate verfy", "posefuse calibrate: unknown command 'verfy'; did you mean verify?; see posefuse calibrate --help"),
        ("track S --ouy R", "posefuse track: missing --out; did you mean --out instead of --ouy?; see posefuse track --help"),
        ("track S --out R --rsume", "Did you mean --resume?"),
        ("track S --out R --weights robst", 'Did you mean "robust"?'),
        ("track S --out", "--out: expected a value"),
        ("track S --out R --person", "--person: expected a value"),
        ("track S --out R --force --resume", "expected one of --force, --resume, got both"),
        ("track S T --out R", "unexpected 'T'"),
        ("track S --out R --out Q", "--out specified multiple times"),
        ("track S --out R --start soon", "--start"),
        ("calibrate person a --intrinsics i --out o --apart a b", "--apart: expected 3 values"),
        ("calibrate person a --intrinsics i --out o --apart a b far", 'unable to convert "far" into float'),
        ("node relay rig.toml", "unknown command 'relay'; there are: camera, fusion"),
    ],
)
def test_a_wrong_command_line_is_one_line_and_exit_1(words: str, line: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(words.split()) == 1
    out, err = capsys.readouterr()
    assert out == "" and err.count("\n") == 1
    assert line in err and err.startswith("posefuse")


@pytest.mark.parametrize("place", ["", *PLACES])
def test_help_fits_80_columns_and_describes_every_option(
    place: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    assert main([*place.split(), "--help"]) == 0
    shown = capsys.readouterr().out
    assert max(len(line) for line in shown.splitlines()) <= 80
    assert f"Usage: posefuse {place}".strip() in shown and "--json" in shown
    for line in shown.splitlines():
        bare = re.match(r"^│ (?:\*| ) *(--[a-z-]+(?: [A-Z.=|,\[\]-]+)?)? *│$", line)
        assert not (bare and bare[1]), f"without a description: {line}"


def test_help_imports_neither_numpy_nor_pydantic() -> None:
    """It takes 0.2 s of processor time so; numpy alone would add a quarter to that."""
    script = "import sys; from posefuse.cli.main import main; main(['--help']); print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True, timeout=120)
    loaded = set(done.stdout.splitlines()[-1].split())
    assert "posefuse.cli.command_line" in loaded and "posefuse.cli.recorded" not in loaded
    assert not loaded & {"numpy", "pydantic"}


@pytest.mark.parametrize("command", ACCEPTED)
def test_the_table_has_every_option_and_the_help_the_usual_ones(
    command: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    words = [word for word in command.split() if word in {*COMMANDS, *(s for steps in STEPS.values() for s in steps)}][:2]
    found = application()
    for word in words:
        found = found[word]
    options = {one.names: one.show for one in found.assemble_argument_collection() if one.parse and one.name.startswith("--")}
    assert main([*words, "--help"]) == 0
    in_help = {word for word in capsys.readouterr().out.split() if word.startswith("--")}
    assert [names for names, shown in options.items() if shown != bool({*names} & in_help)] == []
    in_table = {word.partition("=")[0] for word in " ".join(ACCEPTED[command]).replace(",", " ").split() if word[:2] == "--"}
    assert [names for names in options if not {*names} & in_table] == []


def test_an_option_of_live_is_in_a_group_with_a_name(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["live", "--help"]) == 0
    assert "╭─ Parameters" not in capsys.readouterr().out


def test_the_table_has_every_command() -> None:
    assert {command.split()[0] for command in ACCEPTED} == {*COMMANDS}


def test_no_word_at_all_shows_the_commands_in_groups(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([]) == 0
    out, err = capsys.readouterr()
    assert err == "" and all(f" {title} " in out for title in GROUPS) and all(f"│ {name} " in out for name in COMMANDS)
    assert len(set(COMMANDS)) == len(COMMANDS)
