"""NamedSettings of the commands: those of settings come from the settings classes, so that each is described once."""

import dataclasses
import inspect
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

from cyclopts import Group, Parameter

from posefuse.core import ConfigError
from posefuse.core.extras import package_of_extra

from .terminal import Terminal, option_of

F = TypeVar("F", bound=Callable[..., Any])
Figures = Mapping[str, Any]
Shown = Annotated[Terminal, Parameter(parse=False)]
"""Where a command shows its progress; given by the caller."""
# in the order of the help
CAMERAS, TIMING, OUTPUTS = Group.create_ordered("Cameras"), Group.create_ordered("Timing"), Group.create_ordered("Outputs")
ROS_2, SETTINGS = Group.create_ordered("ROS 2 network"), Group.create_ordered("Settings")
# coordinates may begin with a minus
ONE_WORD: Mapping[str, Any] = {"n_tokens": 1, "accepts_keys": False, "allow_leading_hyphen": True}


def check_used(options: Iterable[tuple[str, object, object, str]]) -> None:
    """Refuse what would be ignored: rows of an option, whether it is given, whether anything takes it, and what it needs.

    Raises:
        ConfigError: one that is given and that nothing takes.
    """
    for option, given, used, needs in options:
        if given and not used:
            raise ConfigError(f"{option}: {needs}")


def without_package(module: str, extra: str) -> Callable[..., Figures]:
    """What a command does whose package is not installed: it names the extra."""

    def command(*_: Annotated[str, Parameter(show=False, allow_leading_hyphen=True)], terminal: Shown) -> Figures:
        package_of_extra(module, extra)
        raise AssertionError(f"{module} can be imported")

    return command


@Parameter(name="*", group=SETTINGS, name_transform=option_of)
@dataclass(frozen=True, kw_only=True)
class NamedSettings:
    """Settings that were given; `settings_options` makes subclasses with one field per named setting, None where not given."""

    @property
    def changes(self) -> dict[str, Any]:
        """What was given, by dotted key: what ``settings=`` of the public functions takes."""
        named = ((field.metadata.get("key"), getattr(self, field.name)) for field in dataclasses.fields(self))
        return {key: value for key, value in named if key and value is not None}


def arguments_of(function: Callable[..., Any], options: Any) -> dict[str, Any]:
    """The options that are arguments of a public function, which have its names, and the settings as one of them."""
    known = inspect.signature(function).parameters
    given = {field.name: getattr(options, field.name) for field in dataclasses.fields(options) if field.name in known}
    return given | ({"settings": options.changes} if isinstance(options, NamedSettings) else {})


@dataclass(frozen=True, kw_only=True)
class NetworkOptions(NamedSettings):
    """Which network the detector uses.

    Attributes:
        networks: 2D network: blazepose_lite, blazepose_full (default), blazepose_heavy, blazepose_best, rtmpose_m and others
            (`posefuse models`), or your own model card (see docs/networks.md).
        device: Processor: auto (default), cpu, cuda or cuda:1, tensorrt, directml, coreml, openvino:gpu, openvino:npu.
    """

    networks: Annotated[str | None, Parameter(metavar="NAME|CARD.toml")] = None
    device: Annotated[str | None, Parameter(metavar="WORD")] = None

    @property
    def changes(self) -> dict[str, Any]:
        """Those of the network, too."""
        from posefuse.detection import network_settings

        return {**super().changes, **network_settings(self.networks, self.device)}


@dataclass(frozen=True, kw_only=True)
class SettingsOptions(NamedSettings):
    """A settings file, and any setting on top of it.

    Attributes:
        config: TOML settings; `track` takes SESSION/posefuse.toml if it is there.
        set_: Any setting, e.g. fuse.score_min=0.2. May be given several times.
    """

    config: Annotated[Path | None, Parameter(metavar="FILE")] = None
    set_: Annotated[tuple[str, ...], Parameter(name="--set", metavar="KEY=VALUE")] = ()

    @property
    def changes(self) -> dict[str, Any]:
        """Those of ``--set`` come last and override."""
        from posefuse.pipeline.config import changes_of

        return {**super().changes, **changes_of(self.set_)}


def settings_options(argument: str, cls: type[Any], named: Mapping[str, str], group: Group = SETTINGS) -> Callable[[F], F]:
    """Decorator of a command: `argument`, annotated with a subclass of `NamedSettings`, gets an option for each setting named.

    Args:
        cls: the settings class, from which type, range, help and default of each option come.
        named: option, with the word for its value, by dotted key of the setting: ``{"rate_hz": "rate HZ"}``.
    """

    def decorate(command: F) -> F:
        base = get_type_hints(command)[argument]
        made = dataclasses.make_dataclass(
            base.__name__,
            [_field(cls, key, option, group) for key, option in named.items()],
            bases=(base,),
            frozen=True,
            kw_only=True,
            namespace={"__module__": base.__module__, "__doc__": base.__doc__},
        )
        command.__annotations__[argument] = Parameter(name="*", group=group, name_transform=option_of)(made)
        if command.__kwdefaults__ and argument in command.__kwdefaults__:
            command.__kwdefaults__[argument] = made()
        return command

    return decorate


def _field(cls: type[Any], key: str, option: str, group: Group) -> tuple[str, Any, Any]:
    from posefuse.foundation.settings import setting_of

    setting = setting_of(cls, key)
    option, _, word = option.partition(" ")
    plain = setting.type is bool or _choices(setting.type) != ()
    parameter = Parameter(
        name=f"--{option}",
        metavar=word or None,
        help=_help(setting.help, setting.default),
        group=group,
        **{} if plain else {"converter": _converter(setting.annotated, word), **ONE_WORD},
    )
    taken = tuple[str, ...] if get_origin(setting.type) is dict else setting.type
    return option.replace("-", "_"), Annotated[taken | None, parameter], dataclasses.field(default=None, metadata={"key": key})


def _help(text: str, default: Any) -> str:
    """The text of a settings class for a terminal: without marks, with the default."""
    text = re.sub(r"`+", "", text)
    stated = default not in (dataclasses.MISSING, None, False, True, (), "") and "default" not in text
    return f"{text[:1].upper()}{text[1:].removesuffix('.')}" + (f" (default {default})." if stated else ".")


def _choices(hint: Any) -> tuple[Any, ...]:
    inner = get_args(hint)
    if get_origin(hint) is Literal:
        return inner
    return next(filter(None, map(_choices, inner)), ()) if get_origin(hint) in (Union, UnionType) else ()


def _converter(hint: Any, word: str) -> Callable[[Any, Any], Any]:
    """One word as a value of a setting, or several parted by commas; checked as a settings file is."""

    def convert(_: Any, tokens: Any) -> Any:
        from pydantic import TypeAdapter, ValidationError

        text = tokens[0].value
        value = [part.strip() for part in text.split(",") if part.strip()] if _is_list(hint) else text
        try:
            found = TypeAdapter(hint, config={"allow_inf_nan": False}).validate_python(value)
        except ValidationError as error:
            why = error.errors()[0]["msg"].partition(",")[0].lower()
            raise ValueError(f"expected {word} ({why}), got {text!r}") from None
        # names of outputs stay names: those that a file describes keep their description
        return tuple(value) if isinstance(found, dict) else found

    return convert


def _is_list(hint: Any) -> bool:
    """Whether a setting holds several values, also inside Annotated and Optional."""
    return get_origin(hint) in (tuple, dict) or any(_is_list(one) for one in get_args(hint) if get_origin(hint) is not Literal)


def positive(most: float) -> Parameter:
    """A number above 0 and at most `most`; NaN and infinity are refused."""

    def check(_: object, value: float | None) -> None:
        if value is not None and not 0 < value <= most:
            raise ValueError(f"expected a number > 0 and <= {most:g}, got {value:g}")

    return Parameter(validator=check)


def count(most: int) -> Parameter:
    """A whole number from 1 to `most`."""

    def check(_: object, value: int | None) -> None:
        if value is not None and not 1 <= value <= most:
            raise ValueError(f"expected a whole number from 1 to {most}, got {value}")

    return Parameter(validator=check)


# the largest values that can be meant: a day
MOST_S = 86_400.0
Seconds = Annotated[float | None, Parameter(metavar="S"), positive(MOST_S)]
OptionalFile = Annotated[Path | None, Parameter(metavar="FILE")]
Sources = Annotated[
    tuple[str, ...],
    Parameter(
        metavar="CAMERA=KIND:WHERE",
        group=CAMERAS,
        help="One per camera: video:FILE, usb:DEVICE[@640x480@30] (Linux /dev/video0, macOS 0, Windows the name), rtsp://..., "
        "http://..., ros:/TOPIC, realsense:SERIAL; or sim:SESSION for all cameras.",
    ),
]


@Parameter(name="*", group=ROS_2)
@dataclass(frozen=True, kw_only=True)
class Ros2Options:
    """Where ROS 2 is.

    Attributes:
        domain: ROS_DOMAIN_ID (default 0).
        peer: Address of another machine, where multicast is off. May be given several times.
        interface: Network interface to use.
        local_only: Nothing leaves this machine.
        sim_time: Stamps of ros: sources and of --ros are simulated time, which /clock gives (use_sim_time).
    """

    domain: Annotated[int | None, Parameter(metavar="ID")] = None
    peer: Annotated[tuple[str, ...], Parameter(metavar="ADDRESS")] = ()
    interface: Annotated[str, Parameter(metavar="NAME")] = ""
    local_only: bool = False
    sim_time: bool = False

    @property
    def settings(self) -> dict[str, Any]:
        """NamedSettings that were given and that sources and outputs of ROS 2 share, by their names there."""
        return {**self.network, **({"sim_time": True} if self.sim_time else {})}

    @property
    def network(self) -> dict[str, Any]:
        """Those of them that state where ROS 2 is."""
        found = {"local_only": self.local_only, "interface": self.interface, "peers": self.peer}
        domain = {} if self.domain is None else {"domain_id": self.domain}
        return {**domain, **{name: value for name, value in found.items() if value}}
