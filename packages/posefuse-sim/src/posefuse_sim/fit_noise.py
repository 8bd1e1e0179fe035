"""A network's own noise and joint centres, fitted to simulated people: what `posefuse fit-noise` runs."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from posefuse.api.arguments import lines_of
from posefuse.core import InputError, Progress
from posefuse.detection.build import DetectorChoice
from posefuse.detection.card import OnnxCard, read_card
from posefuse.detection.networks import OnnxConfig
from posefuse.formats.joint_centres import joint_centres_text
from posefuse.formats.truth import read_truth
from posefuse.foundation.output_file import write_text
from posefuse.foundation.summary import Block, Facts, Heading
from posefuse.pipeline.config import CameraInput, TrackConfig
from posefuse.pipeline.session import find_session
from posefuse.pipeline.track import track_session
from posefuse_sim.fitting import (
    NoiseFit,
    Run,
    collect,
    fit_joint_centres,
    fit_noise,
    noise_text,
    render_everyday,
    render_moving,
)

EVERYDAY, MOVING = "everyday", "moving"
# scenes in which the person was tracked in fewer do not make a table of joint centres
_LEAST_RUNS = 2


@dataclass(frozen=True, kw_only=True)
class FittedCard:
    """What was fitted, and the files next to the card that hold it; no joint centres where too few scenes were tracked."""

    noise_file: Path
    joint_centres_file: Path | None
    noise: NoiseFit

    @property
    def figures(self) -> dict[str, Any]:
        """Plain values."""
        return {
            "noise": self.noise_file,
            "joint_centres": self.joint_centres_file,
            "crops": self.noise.samples,
            "squared_error_over_variance": self.noise.ratio,
            "by_keypoint": self.noise.ratio_of,
        }

    def summary(self) -> list[Block]:
        """The noise, for people."""
        ratio_of = self.noise.ratio_of
        facts = {
            "crops": self.noise.samples,
            "squared error over variance": f"{self.noise.ratio:.2f} per axis; 1 is right",
            "surest": min(ratio_of, key=lambda name: ratio_of[name]),
            "least sure": max(ratio_of, key=lambda name: ratio_of[name]),
        }
        return [Heading("Noise of people left out of the fit"), Facts(facts)]


def fit_card(card_file: Path, scenes_in: Path, *, scenes: int, moving: int, device: str, progress: Progress) -> FittedCard:
    """Fit a card on simulated people and write the files next to it.

    Args:
        scenes_in: folder of the rendered scenes. scenes, moving: how many for the noise, and for the joint centres.
        device: on which the network runs.

    Raises:
        PosefuseError: a card or network that is not right, or a network that finds no person.
    """
    note = lines_of(progress, "scenes")
    card = read_card(card_file, OnnxCard)
    detector = OnnxConfig(card=str(card_file), device=device).build()
    everyday = render_everyday(scenes_in / EVERYDAY, scenes, note)
    samples = []
    for i, folder in enumerate(everyday):
        samples.append(collect(folder, detector, seed=i))
        progress("noise", i + 1, len(everyday))
    seen = [one for one in samples if len(one.error)]
    if not seen:
        raise InputError(f"{card_file}: the network finds no person in any of {len(samples)} scenes; is its card right?")
    made_by = f"posefuse fit-noise: {len(seen)} rendered scenes, {sum(len(one.error) for one in seen)} crops"
    noise = fit_noise(seen, made_by)
    noise_file = card_file.with_suffix(".noise.toml")
    write_text(noise_file, noise_text(noise.noise))
    folders = [*everyday, *render_moving(scenes_in / MOVING, moving, note)]
    choice = DetectorChoice(name="onnx", options={"card": str(card_file.absolute()), "device": device})
    centres_file = _joint_centres(card_file, choice, card, folders, progress)
    return FittedCard(noise_file=noise_file, joint_centres_file=centres_file, noise=noise)


def _joint_centres(
    card_file: Path, choice: DetectorChoice, card: OnnxCard, folders: Sequence[Path], progress: Progress
) -> Path | None:
    runs: list[Run] = []
    for i, folder in enumerate(folders):
        try:
            runs.append(_tracked(folder, choice))
        except InputError as error:
            warnings.warn(f"{folder.name}: left out ({error})", UserWarning, stacklevel=2)
        progress("joint centres", i + 1, len(folders))
    if len(runs) < _LEAST_RUNS:
        line = f"joint centres: the person was tracked in {len(runs)} scenes; expected at least {_LEAST_RUNS}; not fitted"
        warnings.warn(line, UserWarning, stacklevel=2)
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
    done = track_session(find_session(folder, config), config)
    return done.recording.poses, truth
