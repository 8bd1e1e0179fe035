"""Options that the help of each command lists; `--help-all` and the page of commands list all.

An option is here if a person types it in the first hours with its command: one that a tutorial uses or that answers "which
cameras, which people, where to". The others have readers of their own: scripts (`--token`), a lab with one special camera or
network (`--local-only`, `--floor-side-mm`), settings that a file holds as well (`--config`, `--rate`), and what a message names
when it is needed (`--upside-down`, `--offset-ms`).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from cyclopts.help import DefaultFormatter

if TYPE_CHECKING:
    from cyclopts.help import HelpPanel

_WRITES = "--out --report --force"
USUAL = {
    "demo": "--out --force",
    "doctor": "",
    "studio": "--host --open",
    "record": "--source --out --rig --duration --resume",
    "calibrate intrinsics": f"--target {_WRITES}",
    "calibrate extrinsics": f"--target --intrinsics --floor-marker --floor-points --clocks {_WRITES}",
    "calibrate guide": "--target --source --intrinsics --record",
    "calibrate person": f"--intrinsics --height-m --apart --clocks {_WRITES}",
    "calibrate clocks": "--rig --clocks --report --force",
    "calibrate verify": "--rig --target --report --force",
    "calibrate print": "--target --columns --rows --square-mm --marker-mm --ids --cube --page --out --force",
    "track": "--out --force --resume --rig --people --names --start --end --refine-rig --outputs --networks --device --set",
    "solve": "--out --force --exclude --keep-person --no-edits --start --end --outputs --set",
    "batch": "--out --force --jobs --outputs --networks --set",
    "live": "--source --duration --record --videos --ros --osc --json-udp --output --view --people --networks --set",
    "teleoperate": "--source --duration --hand --deadman --i-have-an-emergency-stop --robot --robot-at --elsewhere --box --speed "
    "--limits --view --record --ros --command",
    "node camera": "--source --name --domain --peer",
    "node fusion": "--domain --peer",
    "view": "--session",
    "report": "--out --fit --opensim --opensim-model",
    "export": "--out --outputs --session",
    "compare": "--out --no-time --no-space",
    "simulate": "--out --plan --gazebo --force",
    "models": "--check --from --accept-licence",
    "fit-noise": "--scenes-in",
    "plugins": "",
}
"""Names of the options by command, parted by spaces; `tests/cli/test_options.py` limits their number."""


class UsualOnly(DefaultFormatter):
    """Shows the panels of a command without the options that are not usual."""

    def __init__(self, command: str) -> None:
        super().__init__()
        self._usual = set(USUAL[command].split())

    def __call__(self, console: Any, options: Any, panel: HelpPanel) -> None:
        """Show one panel; one of which nothing is left is not shown."""
        if panel.format == "parameter" and panel.title != "Options":
            panel = panel.copy(entries=[one for one in panel.entries if self._is_usual(one.names)])
        if panel.entries:
            super().__call__(console, options, panel)

    def _is_usual(self, names: tuple[str, ...]) -> bool:
        spelled = {name for name in names if name.startswith("--")}
        return not spelled or bool(spelled & self._usual)
