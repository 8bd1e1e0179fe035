"""Fit the constants of the live tracker's motion models on rendered people and motions that no bench reports.

    PYTHONPATH=. python bench/fit_tracker.py --keep DIR [--sweeps 3]
    PYTHONPATH=. python bench/fit_tracker.py --keep DIR --rest      how the 2D of people who stand differs from frame to frame

Scenes are rendered, and the default network looks at them, as in `bench/body_held_out.py` (bodies of its development seeds), at
30 frames/s; DIR keeps both. Noise that is drawn at random does not do: constants fitted to that left the tracker twice as far
from rendered walking people as every time step fused by itself.

Each constant in turn is made smaller and larger; what scores better stays. The score is the mean of the logarithm of the error at
output time, plus `HONESTY` times the mean square of how far the logarithm of NEES is from that of 3, over all scenes, each with
views as late as a session of this machine has them and with views that come at once: what is uncertain about late ones is the
motion since, about the others the noise. Prints every step, and what stands in `tracking/online/settings.py` when it is adopted.
"""

import argparse
import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from body_rows import scene_of

from posefuse.core import Detections2D, JointCentres, Pose3D, Recording, Truth
from posefuse.core.skeleton import PAPER14, pick_keypoints
from posefuse.evaluation.metrics import true_xyz_at
from posefuse.formats.joint_centres import joint_centres_from_mapping
from posefuse.formats.recording import read_recording, write_recording
from posefuse.formats.truth import read_truth
from posefuse.pipeline.clock import StageClock
from posefuse.pipeline.config import read_config
from posefuse.pipeline.run import track_session
from posefuse.pipeline.session import find_session
from posefuse.realtime.config import LiveConfig
from posefuse.realtime.estimator import warmed_up
from posefuse.realtime.messages import Centres
from posefuse.simulation.session import simulate
from posefuse.tracking.online import MOTION, LiveMotion, MotionModel

SCENES = (
    ("walk", 7300), ("walk", 7301), ("reach", 7300), ("reach", 7301), ("squat", 7302), ("wave", 7302), ("turn", 7303),
    ("overhead", 7303), ("idle", 7304), ("idle", 7305),
)  # fmt: skip
RATE_HZ, SECONDS, OUTPUT_HZ, WARM_UP_S = 30.0, 4.0, 100.0, 1.0
HONESTY = 0.5
STEP = 1.5
MODELS = 4
# joints that are keypoints of the network, too; the others have no covariance of their own
JOINTS = tuple(name for name in PAPER14.keypoints if name not in ("neck", "mid_hip"))
# least and largest acceleration in m/s^2 (the models between them in equal ratios) and how long it lasts, in s
START = {
    "keypoints_calm": 0.2, "keypoints_agile": 20.0, "keypoints_persistence_s": 0.1,
    "body_calm": 0.2, "body_agile": 9.0, "body_persistence_s": 0.77,
    "switch_s": 1.0, "averaging": 0.067, "new_share": 0.36,
}  # fmt: skip
MOST = {"new_share": 1.0}
ARRIVE: Mapping[str, tuple[float, float]] = {"late": (0.02, 0.06), "at once": (0.0, 0.001)}
Rows = dict[tuple[str, str], tuple[float, float]]


def motion_of(constants: Mapping[str, float]) -> LiveMotion:
    """As the tracker takes them."""
    banks = []
    for whose in ("keypoints", "body"):
        reach = np.geomspace(constants[f"{whose}_calm"], constants[f"{whose}_agile"], MODELS)
        lasts = constants[f"{whose}_persistence_s"]
        banks.append(tuple(MotionModel(float(a), lasts) for a in reach))
    shares = {name: constants[name] for name in ("switch_s", "averaging", "new_share")}
    return LiveMotion(keypoints=banks[0], body=banks[1], **shares)


def seen(keep: Path, row: str, seed: int) -> tuple[Recording, Truth]:
    """What the network saw in a scene, from the folder, else rendered and looked at."""
    session = keep / f"{seed}-{row}"
    if not (session / "truth" / "truth.npz").exists():
        simulate(replace(scene_of(row, seed), rate_hz=RATE_HZ, duration_s=SECONDS), session, processes=1)
    return seen_in(keep, session)


def seen_in(keep: Path, session: Path) -> tuple[Recording, Truth]:
    """The same of a rendered session."""
    folder = keep / f"{session.name}-tracked"
    if not (folder / "done").exists():
        config = replace(read_config(None), outputs={}, body="off")

        def silent(*_: object) -> None: ...

        recording = track_session(find_session(session, config), config, StageClock(), silent, silent, silent).recording
        folder.mkdir(exist_ok=True)
        write_recording(folder, recording)
        (folder / "done").touch()
    return read_recording(folder), read_truth(session / "truth" / "truth.npz")


def views_of(recording: Recording) -> list[Detections2D]:
    """The first look at every frame, in the order of exposure."""
    seen, found, row = recording.observations, {}, 0
    for frame, count in enumerate(seen.n_detections.tolist()):
        rows, row = slice(row, row + count), row + count
        camera, t_ns = seen.camera_names[seen.frame_camera[frame]], int(seen.frame_t_ns[frame])
        if count and (t_ns, camera) not in found:
            arrays = {name: getattr(seen, name)[rows] for name in ("xy_img", "score", "sigma_px", "box_img")}
            found[t_ns, camera] = Detections2D(camera=camera, t_ns=t_ns, skeleton=seen.skeleton, **arrays)
    return [found[key] for key in sorted(found)]


def arrivals_of(recording: Recording, arrive: str, seed: int) -> list[tuple[int, Detections2D]]:
    """Views with the times at which they reach the tracker, in ns."""
    views = views_of(recording)
    late_ns = 1e9 * np.random.default_rng(seed).uniform(*ARRIVE[arrive], len(views))
    return sorted(((round(view.t_ns + late), view) for view, late in zip(views, late_ns, strict=True)), key=lambda one: one[0])


def table_of(recording: Recording) -> JointCentres:
    """From the network's keypoints to joint centres."""
    return joint_centres_from_mapping(recording.provenance["joint_centres"], "provenance: joint_centres")


@dataclass(frozen=True)
class Trial:
    """One scene, with its views in the order in which they arrive."""

    recording: Recording
    truth: Truth
    table: JointCentres
    arrivals: list[tuple[int, Detections2D]]

    def poses(self, config: LiveConfig, motion: LiveMotion = MOTION) -> Iterator[Pose3D]:
        """At joint centres, at 100 Hz, after the warm-up."""
        rig, skeleton = self.recording.rig, self.recording.observations.skeleton
        estimator = warmed_up(rig, skeleton, config, motion)
        estimator.centring.learn(Centres(rig.names, self.table))
        waiting, first_ns = list(reversed(self.arrivals)), int(self.truth.t_ns[0])
        for t_ns in np.arange(first_ns, int(self.truth.t_ns[-1]), round(1e9 / OUTPUT_HZ)).tolist():
            while waiting and waiting[-1][0] <= t_ns:
                estimator.add(waiting.pop()[1])
            pose = estimator.placed(estimator.tracker.at(t_ns))
            if t_ns >= first_ns + WARM_UP_S * 1e9 and len(pose.person_id):
                yield pose

    def accuracy(self, motion: LiveMotion = MOTION) -> tuple[float, float, float]:
        """Mean error of the joints at output time in mm, NEES, and the share of joints that came out, in per cent."""
        poses = list(self.poses(LiveConfig(), motion))
        at = [poses[0].skeleton.index(name) for name in JOINTS]
        true = true_xyz_at(self.truth, np.array([pose.t_ns for pose in poses]))[:, 0]
        error = np.array([pose.xyz_world[0, at] for pose in poses]) - pick_keypoints(true, self.truth.skeleton, JOINTS)
        found = np.isfinite(error).all(axis=-1)
        share = 100 * float(found.mean())
        error, cov = error[found], np.array([pose.cov_world[0, at] for pose in poses])[found]
        nees = np.einsum("ni,nij,nj->n", error, np.linalg.inv(cov), error)
        return float(1000 * np.linalg.norm(error, axis=-1).mean()), float(nees.mean()), share


class Trials:
    """The scenes, made once, and how well constants follow them."""

    def __init__(self, keep: Path) -> None:
        self._made: dict[tuple[str, str], Trial] = {}
        for row, seed in SCENES:
            recording, truth = seen(keep, row, seed)
            for arrive in ARRIVE:
                come = arrivals_of(recording, arrive, seed)
                self._made[f"{row} {seed}", arrive] = Trial(recording, truth, table_of(recording), come)

    def judged(self, constants: Mapping[str, float]) -> tuple[float, Rows]:
        """Score (less is better), and per scene and way to arrive the mean error in mm, and NEES."""
        motion = motion_of(constants)
        rows = {name: trial.accuracy(motion)[:2] for name, trial in self._made.items()}
        error, nees = np.array(list(rows.values())).T
        return float(np.log(error).mean() + HONESTY * np.square(np.log(nees / 3)).mean()), rows


def noise_at_rest(recording: Recording) -> dict[str, float]:
    """Medians over keypoints and cameras in px: what is new in every frame, what wanders over the scene, and what is stated."""
    new, wandering, stated = [], [], []
    for name in recording.rig.names:
        views = [view for view in views_of(recording) if view.camera == name]
        xy, sigma = np.array([view.xy_img[0] for view in views]), np.array([view.sigma_px[0] for view in views])
        new.append(np.nanmedian(np.nanstd(np.diff(xy, axis=0), axis=0)) / np.sqrt(2))
        wandering.append(np.nanmedian(np.nanstd(xy, axis=0)))
        stated.append(np.nanmedian(sigma))
    return {"new_px": float(np.median(new)), "wandering_px": float(np.median(wandering)), "stated_px": float(np.median(stated))}


def show(what: str, score: float, rows: Rows) -> None:
    """One line: score, and per scene error in mm and NEES, late and at once."""
    parts = []
    for row, seed in SCENES:
        parts.append(f"{row} " + ", ".join("{:.1f} mm {:.1f}".format(*rows[f"{row} {seed}", arrive]) for arrive in ARRIVE))
    print(f"{score:.4f} {what:36s} {'  '.join(parts)}", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--keep", type=Path, required=True)
    parser.add_argument("--sweeps", type=int, default=3)
    parser.add_argument("--rest", action="store_true")
    args = parser.parse_args()
    args.keep.mkdir(parents=True, exist_ok=True)
    if args.rest:
        for row, seed in SCENES:
            if row == "idle":
                print(json.dumps({"seed": seed, **noise_at_rest(seen(args.keep, row, seed)[0])}))
        return
    trials, best = Trials(args.keep), dict(START)
    score, rows = trials.judged(best)
    show("begin", score, rows)
    for sweep in range(args.sweeps):
        for name in START:
            for factor in (1 / STEP, STEP):
                tried = {**best, name: min(best[name] * factor, MOST.get(name, np.inf))}
                tried_score, tried_rows = trials.judged(tried)
                better = tried_score < score
                show(f"{sweep} {name} {tried[name]:.3g}{' *' if better else ''}", tried_score, tried_rows)
                if better:
                    best, score, rows = tried, tried_score, tried_rows
                    break
    print(json.dumps({name: round(value, 4) for name, value in best.items()}))
    motion = motion_of(best)
    for bank in ("keypoints", "body"):
        print(bank, [(round(one.acceleration_m_s2, 3), round(one.persistence_s, 3)) for one in getattr(motion, bank)])


if __name__ == "__main__":
    main()
