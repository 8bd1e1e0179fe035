"""Fit the constants of the live tracker's motion models on rendered people and motions that no bench reports.

    python bench/fit_tracker.py --keep DIR [--sweeps 3]

Scenes are rendered into DIR, and the default network looks at them, as in `bench/body_held_out.py`, at 30 frames/s. Noise that is
drawn at random does not do: constants fitted to that left the tracker twice as far
from rendered walking people as every time step fused by itself.

Each constant in turn is made smaller and larger; what scores better stays. The score is the mean of the logarithm of the error at
output time, plus `HONESTY` times the mean square of how far the logarithm of NEES is from that of 3, over all scenes, each with
views as late as a session of this machine has them and with views that come at once: what is uncertain about late ones is the
motion since, about the others the noise. Prints every step on stdout, and
what stands in `tracking/settings.py` when it is adopted.
"""

import json
from collections.abc import Mapping

import numpy as np
from bodies import ARRIVE, Trial, trial_session
from harness import OUT, Use, arguments

from posefuse.tracking.online import LiveMotion, MotionModel

SCENES = (
    ("walk", 7300), ("walk", 7301), ("reach", 7300), ("reach", 7301), ("squat", 7302), ("wave", 7302), ("turn", 7303),
    ("overhead", 7303), ("idle", 7304), ("idle", 7305),
)  # fmt: skip
HONESTY = 0.5
STEP = 1.5
MODELS = 4
# least and largest acceleration in m/s^2 (the models between them in equal ratios) and how long it lasts, in s
START = {
    "keypoints_calm": 0.2, "keypoints_agile": 20.0, "keypoints_persistence_s": 0.1,
    "body_calm": 0.2, "body_agile": 9.0, "body_persistence_s": 0.77,
    "switch_s": 1.0, "averaging": 0.067, "new_share": 0.36,
}  # fmt: skip
MOST = {"new_share": 1.0}
Trials = dict[tuple[str, int, str], Trial]


def motion_of(constants: Mapping[str, float]) -> LiveMotion:
    """As the tracker takes them."""
    banks = []
    for whose in ("keypoints", "body"):
        reach = np.geomspace(constants[f"{whose}_calm"], constants[f"{whose}_agile"], MODELS)
        lasts = constants[f"{whose}_persistence_s"]
        banks.append(tuple(MotionModel(float(a), lasts) for a in reach))
    shares = {name: constants[name] for name in ("switch_s", "averaging", "new_share")}
    return LiveMotion(keypoints=banks[0], body=banks[1], **shares)


def judged(what: str, trials: Trials, constants: Mapping[str, float]) -> float:
    """Score, less is better; prints it, and per scene and way to arrive the mean error, and NEES."""
    motion = motion_of(constants)
    rows = {name: trial.accuracy(motion) for name, trial in trials.items()}
    error, nees = np.array([(row["mean_mm"], row["nees"]) for row in rows.values()]).T
    score = float(np.log(error).mean() + HONESTY * np.square(np.log(nees / 3)).mean())
    parts = (f"{row} {seed}, {arrive}: {one['mean_mm']:.1f} mm {one['nees']:.1f}" for (row, seed, arrive), one in rows.items())
    print(f"{score:.4f} {what:36s} {'  '.join(parts)}", flush=True)
    return score


def main() -> None:
    args = arguments(__doc__, keep=OUT / "scenes", sweeps=3)
    sessions = {scene: trial_session(args.keep, *scene, Use.FIT) for scene in SCENES}
    trials = {(*scene, arrive): Trial.of(sessions[scene], arrive, scene[1]) for scene in SCENES for arrive in ARRIVE}
    best = dict(START)
    score = judged("begin", trials, best)
    for sweep in range(args.sweeps):
        for name in START:
            for factor in (1 / STEP, STEP):
                tried = {**best, name: min(best[name] * factor, MOST.get(name, np.inf))}
                tried_score = judged(f"{sweep} {name} {tried[name]:.3g}", trials, tried)
                if tried_score < score:
                    best, score = tried, tried_score
                    break
    print(json.dumps({name: round(value, 4) for name, value in best.items()}))
    motion = motion_of(best)
    for bank in ("keypoints", "body"):
        print(bank, [(round(one.acceleration_m_s2, 3), round(one.persistence_s, 3)) for one in getattr(motion, bank)])


if __name__ == "__main__":
    main()
