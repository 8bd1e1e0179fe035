"""The command line as values: every option has an effect and is described, and what is wrong is one line with the remedy."""

import json
import re
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import asdict, fields, is_dataclass, replace
from functools import cache
from pathlib import Path
from types import MappingProxyType, NoneType
from typing import Any, Literal, get_args, get_origin, get_type_hints

import pytest

from posefuse.api.live_run import output_configs
from posefuse.api.outcome import network_shown
from posefuse.api.track import session_config, study_settings
from posefuse.cli.command_line import COMMANDS, GROUPS, STEPS, USUAL, Invocation, WrongCommandLineError, application, parse
from posefuse.cli.main import main
from posefuse.core import ConfigError
from posefuse.detection.build import DetectorChoice
from posefuse.foundation.plugins import plugin_config
from posefuse.foundation.settings import settings_from_mapping
from posefuse.pipeline.batch.tasks import Task, Trial
from posefuse.pipeline.config import TrackConfig, read_changed
from posefuse.realtime.config import LiveConfig
from posefuse_teleop.settings import TeleoperationSettings

PLACES = [*(name for name in COMMANDS if name not in STEPS), *(f"{name} {step}" for name in STEPS for step in STEPS[name])]
TRACK = "track S --out R"


@cache
def parsed(*texts: str) -> Invocation:
    found = parse([word for text in texts for word in text.split()])
    assert found is not None
    return found


def arguments(place: str) -> Iterator[Any]:
    """What a command takes from the command line; groups of options come as their options."""
    app = application()
    for word in place.split():
        app = app[word]
    yield from (one for one in app.assemble_argument_collection() if one.parse and one.name != "*")


def example(one: Any) -> str:
    """A value of an option that is not its default, as it is typed."""
    [hint, *_] = [kind for kind in get_args(one.hint) or (one.hint,) if kind is not NoneType]
    if get_origin(one.hint) is Literal or get_origin(hint) is Literal:
        kinds = get_args(one.hint if get_origin(one.hint) is Literal else hint)
        return str(next(kind for kind in kinds if kind != one.field_info.default))
    if get_origin(one.hint) is tuple or get_origin(hint) is tuple:
        kinds = [kind for kind in get_args(one.hint if get_origin(one.hint) is tuple else hint) if kind is not ...]
        return (" " if one.token_count()[0] > 1 else ",").join("cam0:1-2" if kind is str else "2" for kind in kinds)
    return "" if hint is bool else "7" if hint is int else "1.5" if hint is float else "text"


@pytest.mark.parametrize("place", PLACES)
def test_every_option_is_understood_and_has_an_effect_and_what_is_needed_is_named(place: str) -> None:
    known = list(arguments(place))
    typed = {one.names: f"{one.names[-1 if one.name == '--open' else 0]} {example(one)}" for one in known if one.name[0] == "-"}
    given = " ".join([place, *(f"{one.name}=text" for one in known if one.name[0] != "-")])
    needed = {one.names: typed.pop(one.names) for one in known if one.required and one.names in typed}
    without = parsed(given, *needed.values())
    assert without.words == tuple(place.split())
    assert [words for words in typed.values() if parsed(given, *needed.values(), words).bound == without.bound] == []
    assert parsed(given, *needed.values(), "--json").as_json and not without.as_json
    for names in needed:
        with pytest.raises(WrongCommandLineError, match=f"missing {names[0]}; see posefuse {place} --help"):
            parsed(given, *(words for other, words in needed.items() if other != names))


@pytest.mark.parametrize("words", ["--json calibrate clocks S", "calibrate --json clocks S", "calibrate clocks --json S"])
def test_json_stands_anywhere(words: str) -> None:
    found = parsed(words)
    assert found.as_json and found.words == ("calibrate", "clocks")


@pytest.mark.parametrize("place", ["-1.1,0", "-.5,-2", "1,-2"])
@pytest.mark.parametrize("form", ["--person={}", "--person {}"])
def test_a_place_left_of_the_origin_is_no_option(place: str, form: str) -> None:
    got = parsed(TRACK, form.format(place), "--raw --people 64").bound.arguments["options"].changes
    assert got == {"associate.near_xy_m": tuple(map(float, place.split(","))), "raw": True, "associate.max_people": 64}


def test_options_that_are_repeated_are_all_kept() -> None:
    found = parsed("live rig.toml --source a=usb:0 --source b=usb:1 --peer one --set a=1 --peer two --set b=2").bound.arguments
    assert found["source"] == ("a=usb:0", "b=usb:1")
    assert found["ros_2"].peer == ("one", "two")
    assert found["settings"].changes == {"a": 1, "b": 2}


@pytest.mark.parametrize(
    ("words", "line"),
    [
        ("trac", "posefuse: unknown command 'trac'; did you mean track?; see posefuse --help"),
        ("calibrate verfy", "posefuse calibrate: unknown command 'verfy'; did you mean verify?; see posefuse calibrate --help"),
        ("track S --ouy R", "posefuse track: missing --out; did you mean --out instead of --ouy?; see posefuse track --help"),
        (f"{TRACK} --rsume", "Did you mean --resume?"),
        (f"{TRACK} --weights robst", 'Did you mean "robust"?'),
        ("track S --out", "--out: expected a value"),
        (f"{TRACK} --person", "--person: expected a value"),
        (f"{TRACK} --person --raw", "--person"),
        (f"{TRACK} --force --resume", "expected one of --force, --resume, got both"),
        ("track S T --out R", "unexpected 'T'"),
        (f"{TRACK} --out Q", "--out specified multiple times"),
        (f"{TRACK} --start soon", "--start"),
        *((f"{TRACK} --people {text}", "--people: expected N (input should be") for text in ("two", "1.5", "0", "1001", "all")),
        *((f"{TRACK} --start={text}", "--start: expected S (input should be") for text in ("nan", "inf", "1e300")),
        *((f"{TRACK} --person={text}", "--person: expected X,Y (input should be") for text in ("nan,0", "1e300,0")),
        *((f"live R --rate={text}", "--rate") for text in ("0", "-5", "nan", "inf", "1e9", "1001")),
        *((f"live R --groups={text}", "--groups") for text in ("0", "-2")),
        ("calibrate print --target markers --marker-mm nan --ids 1 --out a.pdf", "--marker-mm: expected MM ("),
        ("calibrate clocks here --seconds inf", "--seconds: expected "),
        ("calibrate verify a=b --rig rig.toml --target b.toml --every 0", "--every: expected a whole number"),
        ("simulate scene.yaml --out there --workers -1", "--workers: expected a whole number"),
        ("compare a.trc b.trc --align-first nan", "--align-first: expected "),
        ("calibrate person a --intrinsics i --out o --apart a b", "--apart: expected 3 values"),
        ("calibrate person a --intrinsics i --out o --apart a b far", '--apart: unable to convert "far" into float'),
        ("node relay rig.toml", "unknown command 'relay'; there are: camera, fusion"),
    ],
)
def test_a_wrong_command_line_is_one_line_and_exit_1(words: str, line: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(words.split()) == 1
    out, err = capsys.readouterr()
    assert out == "" and err.count("\n") == 1
    assert line in err and err.startswith("posefuse")


@pytest.mark.parametrize("place", ["", *STEPS, *PLACES])
def test_help_fits_80_columns_and_describes_every_option_that_is_shown(place: str, capsys, monkeypatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    assert main([*place.split(), "--help"]) == 0
    shown = capsys.readouterr().out
    assert max(len(line) for line in shown.splitlines()) <= 80
    assert f"Usage: posefuse {place}".strip() in shown and "--json" in shown
    assert place != "live" or "╭─ Parameters" not in shown
    for line in shown.splitlines():
        bare = re.match(r"^│ (?:\*| ) *(--[a-z-]+(?: [A-Z.=|,\[\]-]+)?)? *│$", line)
        assert not (bare and bare[1]), f"without a description: {line}"


@pytest.mark.parametrize("place", PLACES)
def test_the_help_has_the_usual_options_and_help_all_every_one(place: str, capsys, monkeypatch) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    options, usual = [one.names for one in arguments(place) if one.name[0] == "-"], {*USUAL[place].split()}
    assert usual <= {name for names in options for name in names}
    for asked, expected in (("--help", [names for names in options if {*names} & usual]), ("--help-all", options)):
        assert main([*place.split(), asked]) == 0
        # an option begins its line; texts may name others
        in_help = {*re.findall(r"^│ (?:\* +| +)?(--[a-z0-9-]+)", capsys.readouterr().out, re.MULTILINE)}
        assert [names for names in options if bool({*names} & in_help) != (names in expected)] == []


def test_few_options_are_shown() -> None:
    assert {*USUAL} == {*PLACES}
    assert sum(len(names.split()) for names in USUAL.values()) <= 130


@pytest.mark.parametrize("words", [(), ("calibrate",)])
def test_without_a_command_the_help_is_shown(words: tuple[str, ...], capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*words]) == 0
    shown = capsys.readouterr()
    main([*words, "--help"])
    assert shown.out == capsys.readouterr().out and shown.err == ""
    titles = [line.split()[1] for line in shown.out.splitlines() if line.startswith("╭─ ")]
    assert titles == (["Commands", "Options"] if words else [title.split()[0] for title in (*GROUPS, "Options")])


# --- `--networks` on every command that has it: a bundled network's name, or a model card


def changes_of(*words: str) -> dict[str, Any]:
    found = parse(["live", "rig.toml", *words])
    assert found is not None
    found.bound.apply_defaults()
    changes: dict[str, Any] = found.bound.arguments["settings"].changes
    return changes


def test_a_name_or_a_card_of_blazepose_stays_with_the_default_detector_and_does_not_come_back(tmp_path: Path) -> None:
    (tmp_path / "both.toml").write_text('kind = "heatmap_landmarks"\n')
    for name in ("blazepose_lite", str(tmp_path / "both.toml")):
        assert changes_of("--networks", name) == {"detector.options.landmarks": name}
    assert changes_of() == {}


def test_a_card_of_the_user_chooses_the_plug_in_for_it(tmp_path: Path) -> None:
    card = tmp_path / "mine.toml"
    card.write_text('kind = "simcc"\n')
    changes = changes_of("--set", "raw=true", "--networks", str(card), "--set", "detector.options.device=cuda")
    config = read_changed(None, changes, TrackConfig)
    assert config.raw and config.detector.name == "onnx"
    assert config.detector.options == {"card": str(card), "device": "cuda"}


def test_the_result_names_the_network_that_was_used() -> None:
    shown = [network_shown(DetectorChoice(options=options)) for options in ({}, {"landmarks": "blazepose_lite"})]
    assert shown == ["blazepose_full", "blazepose_lite"]
    assert network_shown(DetectorChoice(name="onnx", options={"card": "mine.toml"})) == "mine.toml"
    assert network_shown(DetectorChoice(name="oracle", options={"truth": "truth.npz"})) == "oracle"


@pytest.mark.parametrize(
    "command",
    ["track S --out R", "live rig.toml", "node camera rig.toml", "calibrate person a=a --intrinsics i --out o.toml"],
)
def test_a_card_that_is_missing_is_one_line(command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*command.split(), "--networks", str(tmp_path / "absent.toml")]) == 1
    error = capsys.readouterr().err.strip()
    assert "absent.toml" in error and "\n" not in error


# --- a settings file is obeyed: each of its values reaches the command, unless the option for that value was given


SESSION = Path("SESSION")
# what outputs cannot be without
OUTPUTS = {"record": {"path": "file.mcap"}, "ros2": {}, "osc": {"to": ["file:1"]}, "json": {"to": ["file:1"]}, "rerun": {}}
# command with what it needs: the option of the file, its class, and the options about the same settings with other values
WITH_FILES: dict[str, tuple[str, type[Any], str]] = {
    "teleoperate rig.toml": (
        "--limits",
        TeleoperationSettings,
        "--hand both, --scale 2, --turn 90, --robot-at 1,2,90, --elsewhere, --box 0,0,0,1,2,3, --speed 0.2",
    ),
    "live rig.toml": (
        "--config",
        LiveConfig,
        "--body off, --people 2, --names A,B, --rate 50, --groups 2, --domain 3, "
        "--peer one, --interface text, --local-only, --sim-time, --record other.mcap, "
        "--ros --local-only, --ros1, --osc host:1, --json-udp host:1, --output lsl, --axes y_up, --view-file other.rrd",
    ),
    "track SESSION --out text": (
        "--config",
        TrackConfig,
        "--rig text, --input pose2d, --weights score, --raw, --body off, --person -1.1,0, --start 1, --end 2, --outputs trc, "
        "--rate 50, --people 2, --names A,B",
    ),
    "batch STUDY --out text": ("--config", TrackConfig, "--outputs trc"),
}


def leaves(value: Any, key: str = "") -> Iterator[tuple[str, Any]]:
    inside = {one.name: getattr(value, one.name) for one in fields(value)} if is_dataclass(value) else value
    if isinstance(inside, Mapping) and inside:
        for name, one in inside.items():
            yield from leaves(one, f"{key}.{name}")
    else:
        yield key, list(value) if isinstance(value, tuple) else str(value) if isinstance(value, Path) else value


def by_key(config: TrackConfig) -> dict[str, Any]:
    """Every setting, the outputs by their names."""
    return {**dict(leaves(replace(config, outputs={}))), ".outputs": list(config.outputs)}


def read(*texts: str) -> dict[str, Any]:
    """Every setting that a command line results in, by its key."""
    words = [word for text in texts for word in text.split()]
    found = parse(words)
    assert found is not None
    found.bound.apply_defaults()
    given = found.bound.arguments
    if words[0] == "teleoperate":
        return dict(leaves(read_changed(given["robot"].limits, given["robot"].changes, TeleoperationSettings)))
    if words[0] == "live":
        config = read_changed(given["settings"].config, given["settings"].changes, LiveConfig)
        axes = {"axes": given["outputs"].axes} if given["outputs"].axes else {}
        outputs = output_configs(config, given["outputs"].chosen, {**given["ros_2"].settings, **axes})
        return {**dict(leaves(config)), **dict(leaves(outputs, ".outputs"))}
    if words[0] == "track":
        config = session_config(SESSION, given["options"].config, given["options"].changes)
    else:
        changes, formats = study_settings(given["options"].config, given["options"].changes)
        trial = Trial(name="trial", session=SESSION)
        config = Task(trial=trial, out=Path(), settings={"outputs": formats, **changes}, report=False).config
    return by_key(config)


def others(hint: Any, value: Any) -> Iterator[Any]:
    """Values to try in place of a default."""
    yield from (one for one in get_args(hint) if isinstance(one, str))
    if isinstance(value, tuple) and value:
        plain = [asdict(one) if is_dataclass(one) else one for one in value]
        yield from ([next(others(None, one)) for one in plain], plain[1:], plain[::-1])
    if isinstance(value, float) and not isinstance(value, bool):
        yield from (value * 0.9, value + 0.5)
    if isinstance(value, int) and not isinstance(value, bool):
        yield value + 1
    yield from (not value, 0.5, 3, "text", ["left"], ["text"], [1.0, 2.0], {"text": 1})


def varied(cls: type[Any], given: Mapping[str, Any] = MappingProxyType({})) -> dict[str, Any]:
    """Content of a file in which no setting has its default, all of them legal together; `given` is part of it."""
    content = dict(given)

    def fill(default: Any, into: dict[str, Any]) -> None:
        hints = get_type_hints(type(default))
        for one in fields(default):
            value = getattr(default, one.name)
            if is_dataclass(value):
                fill(value, into.setdefault(one.name, {}))
            elif one.name not in into:
                before = made()
                for other in others(hints[one.name], value):
                    into[one.name] = other
                    with suppress(ConfigError):
                        if made() != before:
                            break
                else:
                    pytest.fail(f"{type(default).__name__}.{one.name}: found no other value than {value!r}")

    def made() -> Any:
        return settings_from_mapping(content, cls, where="test")

    fill(made(), content)
    return content


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> dict[str, tuple[str, str]]:
    """By command: the option with a file of defaults, and with one in which no setting has its default."""
    folder, found = tmp_path_factory.mktemp("settings"), {}
    for command, (option, cls, _) in WITH_FILES.items():
        bare: dict[str, Any] = {"outputs": OUTPUTS} if cls is LiveConfig else {}
        outputs = {name: varied(type(plugin_config("live_outputs", name, one)), one) for name, one in OUTPUTS.items()}
        # with another tracker only this body is taken
        given = {LiveConfig: {"body": "off", "outputs": outputs}, TrackConfig: {"cameras": {"text": {"skip": True}}}}.get(cls, {})
        texts = []
        for name, content in {"bare": bare, "varied": varied(cls, given)}.items():
            file = folder / f"{command.split()[0]}_{name}.yaml"
            # YAML takes JSON
            file.write_text(json.dumps(content))
            texts.append(f"{option} {file}")
        found[command] = (texts[0], texts[1])
    return found


@pytest.mark.parametrize("command", WITH_FILES)
def test_every_setting_of_a_file_reaches_the_command(command: str, files: dict[str, tuple[str, str]]) -> None:
    content = json.loads(Path(files[command][1].split()[1]).read_text())
    settings = settings_from_mapping(content, WITH_FILES[command][1], where="test")
    expected = by_key(settings) if isinstance(settings, TrackConfig) else dict(leaves(settings))
    got, plain = read(command, files[command][1]), read(command)
    assert {key: got[key] for key in expected} == expected
    assert [key for key in plain if plain[key] == expected.get(key)] == []


@pytest.mark.parametrize("command", WITH_FILES)
def test_an_option_overrides_the_file(command: str, files: dict[str, tuple[str, str]]) -> None:
    bare, file = files[command]
    plain, of_file = read(command, bare), read(command, file)
    for option in WITH_FILES[command][2].split(", "):
        alone, both = read(command, bare, option), read(command, file, option)
        own = {key for key in alone if plain.get(key) != alone[key]}
        assert own and {key: both[key] for key in own} == {key: alone[key] for key in own}, option
        assert {key for key in both if both[key] != of_file.get(key)} <= own, option


def test_an_output_that_an_option_chooses_keeps_its_settings_in_the_file(files: dict[str, tuple[str, str]]) -> None:
    _, file = files["live rig.toml"]
    of_file = read("live rig.toml", file)
    assert read("live rig.toml", file, "--ros") == of_file
    # the viewer instead of its file
    assert read("live rig.toml", file, "--view") == {**of_file, ".outputs.rerun.file": None}


@pytest.mark.parametrize("command", WITH_FILES)
def test_the_default_in_the_help_is_true_and_overrides_the_file_when_given(
    command: str, files: dict[str, tuple[str, str]], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "400")
    assert main([command.split()[0], "--help"]) == 0
    bare, file = files[command]
    plain, of_file = read(command, bare), read(command, file)
    for option, value in re.findall(r"│ +(--[\w-]+) .*\(default ([^\s()]+)\)", capsys.readouterr().out):
        if option not in WITH_FILES[command][2]:
            continue
        assert read(command, bare, f"{option} {value}") == plain, option
        both = read(command, file, f"{option} {value}")
        changed = {key for key in both if both[key] != of_file[key]}
        assert changed and all(both[key] == plain[key] for key in changed), option
