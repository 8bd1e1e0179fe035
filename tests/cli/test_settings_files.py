"""A settings file is obeyed: each of its values reaches the command, unless the option for that value was given."""

import json
import re
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import asdict, fields, is_dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, get_args, get_type_hints

import pytest

from posefuse.api.live_run import output_configs
from posefuse.api.track import session_config, study_settings
from posefuse.cli.command_line import parse
from posefuse.cli.main import main
from posefuse.core import ConfigError
from posefuse.foundation.plugins import plugin_config
from posefuse.foundation.settings import settings_from_mapping
from posefuse.pipeline.batch.tasks import Task, Trial
from posefuse.pipeline.config import TrackConfig, read_changed
from posefuse.realtime.config import LiveConfig
from posefuse_teleop.settings import TeleoperationSettings

SESSION = Path("SESSION")
# what outputs cannot be without
OUTPUTS = {"record": {"path": "file.mcap"}, "ros2": {}, "osc": {"to": ["file:1"]}, "json": {"to": ["file:1"]}, "rerun": {}}
# command with what it needs: the option of the file, its class, and the options about the same settings with other values
COMMANDS: dict[str, tuple[str, type[Any], str]] = {
    "teleoperate rig.toml": (
        "--limits",
        TeleoperationSettings,
        "--hand both, --scale 2, --turn 90, --orientation forearm, --robot-at 1,2,90, --elsewhere, --box 0,0,0,1,2,3, "
        "--speed 0.2",
    ),
    "live rig.toml": (
        "--config",
        LiveConfig,
        "--body off, --people 2, --names A,B, --rate 50, --groups 2, --camera-info use, --domain 3, "
        "--peer one, --interface text, --local-only, --sim-time, --record other.mcap, --record other.mcap --record-images, "
        "--ros --local-only, --ros1, --osc host:1, --json-udp host:1, --output lsl, --axes y_up, --view-file other.rrd",
    ),
    "track SESSION --out text": (
        "--config",
        TrackConfig,
        "--rig text, --input pose2d, --weights score, --raw, --body off, --person -1.1,0, --start 1, --end 2, --outputs trc, "
        "--rate 50, --people 2, --names A,B, --refine-rig",
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
    for command, (option, cls, _) in COMMANDS.items():
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


@pytest.mark.parametrize("command", COMMANDS)
def test_every_setting_of_a_file_reaches_the_command(command: str, files: dict[str, tuple[str, str]]) -> None:
    content = json.loads(Path(files[command][1].split()[1]).read_text())
    settings = settings_from_mapping(content, COMMANDS[command][1], where="test")
    expected = by_key(settings) if isinstance(settings, TrackConfig) else dict(leaves(settings))
    got, plain = read(command, files[command][1]), read(command)
    assert {key: got[key] for key in expected} == expected
    assert [key for key in plain if plain[key] == expected.get(key)] == []


@pytest.mark.parametrize("command", COMMANDS)
def test_an_option_overrides_the_file(command: str, files: dict[str, tuple[str, str]]) -> None:
    bare, file = files[command]
    plain, of_file = read(command, bare), read(command, file)
    for option in COMMANDS[command][2].split(", "):
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


@pytest.mark.parametrize("command", COMMANDS)
def test_the_default_in_the_help_is_true_and_overrides_the_file_when_given(
    command: str, files: dict[str, tuple[str, str]], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "400")
    assert main([command.split()[0], "--help"]) == 0
    bare, file = files[command]
    plain, of_file = read(command, bare), read(command, file)
    for option, value in re.findall(r"│ +(--[\w-]+) .*\(default ([^\s()]+)\)", capsys.readouterr().out):
        if option not in COMMANDS[command][2]:
            continue
        assert read(command, bare, f"{option} {value}") == plain, option
        both = read(command, file, f"{option} {value}")
        changed = {key for key in both if both[key] != of_file[key]}
        assert changed and all(both[key] == plain[key] for key in changed), option
