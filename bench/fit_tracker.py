"""Fit the constants of the live tracker's motion models on people and motions that bench/live_tracking.py does not report.

    python bench/fit_tracker.py [--sweeps 3] [--seconds 7]

Each constant in turn is made smaller and larger; what scores better stays. The score is the mean of the logarithm of the error at
output time, plus `HONESTY` times the mean square of how far the logarithm of NEES is from that of 3, over all motions, each with
views as late as in bench/live_tracking.py and with views that come at once: what is uncertain about late ones is the motion
since, about the others the noise. Cameras and noise are those of that bench, with seeds of their own. Prints every step, and what
stands in `tracking/online/settings.py` when it is adopted.
"""

import argparse
import json
from collections.abc import Callable, Mapping

import live_tracking as bench
import numpy as np
from live_motions import Place, crouching, jumping, swinging

from posefuse.core.skeleton import ANATOMICAL23
from posefuse.tracking.online import LiveSettings
from posefuse.tracking.online.settings import MotionModelSettings

SEED = 40
HONESTY = 0.5
STEP = 1.5
MODELS = 4
# least and largest acceleration in m/s^2 (the models between them in equal ratios) and how long it lasts, in s
START = {
    "keypoints_calm": 0.13, "keypoints_agile": 30.0, "keypoints_persistence_s": 0.15,
    "body_calm": 0.3, "body_agile": 9.0, "body_persistence_s": 0.34,
    "switch_s": 0.3, "averaging": 0.1, "learnt_share": 0.6, "learnt_s": 0.8,
}  # fmt: skip
MOST = {"learnt_share": 0.95}
ARRIVE: Mapping[str, dict] = {"late": {}, "at once": bench.LIMITS["at once"]}
PEOPLE = {
    "idle": {"kind": "idle"},
    "stroll": {"kind": "walk", "path": {"shape": "circle", "radius_m": 1.1}, "speed_mps": 0.9},
    "march": {"kind": "walk", "path": {"shape": "circle", "radius_m": 1.7}, "speed_mps": 1.7},
}


def squatting(place: Place) -> Place:
    """The same person, hips down by 0.4 m and up again every 1.8 s."""
    return crouching(place, lambda t_s: 0.2 * (1 - np.cos(2 * np.pi * t_s / 1.8)))


def hopping(place: Place) -> Place:
    """The same person, hopping lower and oftener than in the report; see `jumping`."""
    return jumping(place, flight_s=0.36, ground_s=0.42)


def waving(place: Place) -> Place:
    """The same person, both arms swinging by 40 degrees each way, 1.4 times a second."""
    return swinging(place, degrees=40.0, rate_hz=1.4)


MOTIONS: Mapping[str, tuple[str, Callable[[Place], Place]]] = {
    "idle": ("idle", lambda place: place),
    "stroll": ("stroll", lambda place: place),
    "march": ("march", lambda place: place),
    "squat": ("idle", squatting),
    "hop": ("idle", hopping),
    "wave": ("idle", waving),
}
Rows = dict[tuple[str, str], tuple[float, float]]
WAVING = ("left_wrist", "right_wrist", "left_elbow", "right_elbow")


def settings_of(constants: Mapping[str, float]) -> LiveSettings:
    """As the tracker takes them."""
    banks = []
    for whose in ("keypoints", "body"):
        reach = np.geomspace(constants[f"{whose}_calm"], constants[f"{whose}_agile"], MODELS)
        lasts = constants[f"{whose}_persistence_s"]
        banks.append(tuple(MotionModelSettings(acceleration_m_s2=float(a), persistence_s=lasts) for a in reach))
    shares = {name: constants[name] for name in ("switch_s", "averaging", "learnt_share", "learnt_s")}
    return LiveSettings(motion_models=banks[0], body_models=banks[1], **shares)


class Trials:
    """The motions with their views, made once, and how well settings follow them."""

    def __init__(self, seconds: float) -> None:
        self._seconds, self._made = seconds, {}
        for number, (name, (person, change)) in enumerate(MOTIONS.items()):
            rig, place = bench.scene_of_person(PEOPLE[person], 4, seconds, SEED + number)
            moved = change(place)
            for arrive, how in ARRIVE.items():
                self._made[name, arrive] = rig, moved, bench.arrivals(rig, moved, seconds, SEED + number, **how)

    def judged(self, constants: Mapping[str, float]) -> tuple[float, Rows]:
        """Score (less is better), and per motion and way to arrive the mean error in mm of what moves, and its NEES."""
        settings, rows = settings_of(constants), {}
        for (name, arrive), (rig, place, come) in self._made.items():
            fast = WAVING if name == "wave" else ANATOMICAL23.keypoints
            row = bench.accuracy(rig, place, fast, come, self._seconds, settings)
            rows[name, arrive] = row["fast_mean_mm"], row["fast_nees"]
        error, nees = np.array(list(rows.values())).T
        return float(np.log(error).mean() + HONESTY * np.square(np.log(nees / 3)).mean()), rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sweeps", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=7.0)
    args = parser.parse_args()
    trials, best = Trials(args.seconds), dict(START)
    score, rows = trials.judged(best)
    tell("begin", score, rows)
    for sweep in range(args.sweeps):
        for name in START:
            for factor in (1 / STEP, STEP):
                tried = {**best, name: min(best[name] * factor, MOST.get(name, np.inf))}
                tried_score, tried_rows = trials.judged(tried)
                better = tried_score < score
                tell(f"{sweep} {name} {tried[name]:.3g}{' *' if better else ''}", tried_score, tried_rows)
                if better:
                    best, score, rows = tried, tried_score, tried_rows
                    break
    print(json.dumps({name: round(value, 4) for name, value in best.items()}))
    settings = settings_of(best)
    for bank in ("motion_models", "body_models"):
        print(bank, [(round(one.acceleration_m_s2, 3), round(one.persistence_s, 3)) for one in getattr(settings, bank)])


def tell(what: str, score: float, rows: Rows) -> None:
    """One line: score, and per motion error in mm and NEES, late and at once."""
    told = []
    for name in MOTIONS:
        told.append(f"{name} " + ", ".join("{:.1f} mm {:.1f}".format(*rows[name, arrive]) for arrive in ARRIVE))
    print(f"{score:.4f} {what:36s} {'  '.join(told)}", flush=True)


if __name__ == "__main__":
    main()
