"""What `posefuse fit-noise` does: scenes, two fits, the files next to the card, the table at the end."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from posefuse.cli.command_options import FitOptions
from posefuse.core import InputError
from posefuse.detection.build import DetectorChoice
from posefuse.detection.card import NetworkCard, read_network_card
from posefuse.detection.networks import OnnxConfig
from posefuse.evaluation.fitting import (
    NoiseFit,
    Run,
    collect,
    fit_joint_centres,
    fit_noise,
    noise_text,
    render_everyday,
    render_moving,
)
from posefuse.formats.joint_centres import joint_centres_text
from posefuse.formats.truth import read_truth
from posefuse.foundation.output_file import write_text
from posefuse.pipeline.clock import StageClock
from posefuse.pipeline.config import CameraInput, TrackConfig
from posefuse.pipeline.run import track_session
from posefuse.pipeline.session import find_session

from .terminal import Terminal

EVERYDAY, MOVING = "everyday", "moving"
# scenes in which the person was tracked in fewer do not make a table of joint centres
_LEAST_RUNS = 2


def fit_card(card_file: Path, options: FitOptions, terminal: Terminal) -> Mapping[str, Any]:
    """Fit a card on simulated people; returns the figures of the tables.

    Raises:
        PosefuseError: a card or network that is not right, or a network that finds no person.
    """
    card = read_network_card(card_file)
    detector = OnnxConfig(card=card_file, engine=options.engine).build()
    everyday = render_everyday(options.scenes_in / EVERYDAY, options.scenes, terminal.note)
    with terminal.progress("noise") as advance:
        samples = []
        for i, folder in enumerate(everyday):
            samples.append(collect(folder, detector, seed=i))
            advance(i + 1, len(everyday))
    seen = [one for one in samples if len(one.error)]
    if not seen:
        raise InputError(f"{card_file}: the network finds no person in any of {len(samples)} scenes; is its card right?")
    made_by = f"posefuse fit-noise: {len(seen)} rendered scenes, {sum(len(one.error) for one in seen)} crops"
    noise = fit_noise(seen, made_by)
    noise_file = card_file.with_suffix(".noise.toml")
    write_text(noise_file, noise_text(noise.noise))
    _show(terminal, noise)
    moving = render_moving(options.scenes_in / MOVING, options.moving, terminal.note)
    centres_file = _joint_centres(card_file, options, card, [*everyday, *moving], terminal)
    add = [f'noise = "{noise_file.name}"', *([f'joint_centres = "{centres_file.name}"'] if centres_file else [])]
    terminal.next(f"add to {card_file}: {'; '.join(add)}", "the fits are used from then on")
    return {
        "noise": noise_file,
        "joint_centres": centres_file,
        "crops": noise.samples,
        "squared_error_over_variance": noise.ratio,
        "by_keypoint": noise.ratio_of,
    }


def _joint_centres(
    card_file: Path, options: FitOptions, card: NetworkCard, folders: Sequence[Path], terminal: Terminal
) -> Path | None:
    choice = DetectorChoice(name="onnx", options={"card": str(card_file.absolute()), "engine": options.engine})
    runs: list[Run] = []
    with terminal.progress("joint centres") as advance:
        for i, folder in enumerate(folders):
            try:
                runs.append(_tracked(folder, choice))
            except InputError as error:
                terminal.warn(f"{folder.name}: left out ({error})")
            advance(i + 1, len(folders))
    if len(runs) < _LEAST_RUNS:
        terminal.warn(f"joint centres: the person was tracked in {len(runs)} scenes; expected at least {_LEAST_RUNS}; not fitted")
        return None
    path = Path(card_file.with_suffix(".joint_centres.toml"))
    write_text(path, joint_centres_text(fit_joint_centres(runs, f"{card.name}, fitted to {len(runs)} simulated bodies")))
    return path


def _tracked(folder: Path, choice: DetectorChoice) -> Run:
    """What the pipeline makes of a scene, time step by time step and uncorrected, and the truth."""
    truth = read_truth(folder / "truth" / "truth.npz")
    inputs = {name: CameraInput(images=f"videos/{name}") for name in truth.rig.names}
    rate_hz = 1e9 / float(truth.views[0].t_ns[1] - truth.views[0].t_ns[0])
    config = TrackConfig(detector=choice, raw=True, joint_centres=False, rate_hz=rate_hz, cameras=inputs)

    def silent(*_: object) -> None: ...

    done = track_session(find_session(folder, config), config, StageClock(), silent, silent, silent)
    return done.recording.poses, truth


def _show(terminal: Terminal, noise: NoiseFit) -> None:
    terminal.facts(
        "Noise of people left out of the fit",
        {
            "crops": noise.samples,
            "squared error over variance": f"{noise.ratio:.2f} per axis; 1 is right",
            "surest": min(noise.ratio_of, key=lambda name: noise.ratio_of[name]),
            "least sure": max(noise.ratio_of, key=lambda name: noise.ratio_of[name]),
        },
    )
