"""Joint centres by people's proportions: right on average and as sure as it says, and an end to short forearms."""

import numpy as np
import pytest

from posefuse.core import SKELETONS, Kind, PoseSequence
from posefuse.core.joint_centres import SEGMENT_ENDS
from posefuse.tracking import Proportions, proportional_joint_centres, to_joint_centres
from posefuse.tracking.proportions import _LENGTHENS, conditional_offsets, offset_sigma_m

COCO = SKELETONS["coco17"]
T = 30
# another body than the average of the proportions: of a simulated woman, metres
LENGTHS = {"upper_arm": 0.262, "forearm": 0.243, "thigh": 0.389, "shank": 0.39, "shoulders": 0.318, "hips": 0.176, "trunk": 0.49}


def person(lengths: dict[str, float], seed: int = 0) -> np.ndarray:
    """(T, K, 3) joint centres of a person who moves arms and legs about; the head is left out."""
    rng = np.random.default_rng(seed)
    xyz = np.full((T, len(COCO), 3), np.nan)
    for side, y in (("left", 1.0), ("right", -1.0)):
        hip = np.tile([0.0, y * lengths["hips"] / 2, 0.9], (T, 1))
        shoulder = np.tile([0.0, y * lengths["shoulders"] / 2, 0.9 + lengths["trunk"]], (T, 1))
        chain = {"hip": hip, "shoulder": shoulder}
        for first, second, third, upper, lower, bend in (
            ("hip", "knee", "ankle", "thigh", "shank", -0.4),
            ("shoulder", "elbow", "wrist", "upper_arm", "forearm", 0.7),
        ):
            lift, out = rng.uniform(-0.3, 0.6, T), rng.uniform(0.05, 0.6, T)
            down = np.stack([np.sin(lift), y * np.sin(out), -np.cos(lift) * np.cos(out)], axis=-1)
            down /= np.linalg.norm(down, axis=-1, keepdims=True)
            turned = lift + bend
            next_ = np.stack([np.sin(turned), y * np.sin(out), -np.cos(turned) * np.cos(out)], axis=-1)
            next_ /= np.linalg.norm(next_, axis=-1, keepdims=True)
            chain[second] = chain[first] + lengths[upper] * down
            chain[third] = chain[second] + lengths[lower] * next_
        for joint, path in chain.items():
            xyz[:, COCO.index(f"{side}_{joint}")] = path
    return xyz


def sequence(xyz: np.ndarray) -> PoseSequence:
    shape = (T, 1, len(COCO))
    known = np.isfinite(xyz).all(-1)[:, None]
    cov = np.broadcast_to(np.eye(3) * 1e-4, (*shape, 3, 3))
    kind = np.where(known, Kind.FUSED, Kind.MISSING)
    return PoseSequence(
        t_ns=np.arange(T) * 10**7,
        skeleton=COCO,
        person_id=np.arange(1),
        xyz_world=xyz[:, None],
        cov_world=cov,
        reproj_px=np.ones(shape),
        n_views=np.full(shape, 4),
        kind=kind,
    )


def too_close(xyz: np.ndarray, wrist_m: float, elbow_m: float) -> np.ndarray:
    """Keypoints as detectors mark them: wrists and elbows too close to the trunk, along the arm."""
    marked = xyz.copy()
    for side in ("left", "right"):
        shoulder, elbow, wrist = (COCO.index(f"{side}_{joint}") for joint in ("shoulder", "elbow", "wrist"))
        for end, start, metres in ((elbow, shoulder, elbow_m), (wrist, elbow, wrist_m)):
            along = xyz[:, end] - xyz[:, start]
            marked[:, end] -= metres * along / np.linalg.norm(along, axis=-1, keepdims=True)
    return marked


def error_m(xyz: np.ndarray, truth: np.ndarray, joint: str) -> float:
    index = COCO.indices([f"left_{joint}", f"right_{joint}"])
    return float(np.linalg.norm(xyz[:, index] - truth[:, index], axis=-1).mean())


@pytest.fixture(scope="module")
def table():
    return proportional_joint_centres(COCO)


def test_for_people_and_detectors_as_assumed_the_offsets_are_unbiased_with_the_stated_sigma():
    known, rng, n = Proportions(), np.random.default_rng(0), 20_000
    share, spread = (np.array([values[s] for s in SEGMENT_ENDS]) for values in (known.share, known.spread))
    stature = known.stature_m + known.stature_sigma_m * rng.standard_normal(n)
    # of one stature people differ by the average's spread
    lengths = stature[:, None] * share + share * known.stature_m * spread * rng.standard_normal((n, len(SEGMENT_ENDS)))
    offsets = np.array([known.offset_m[joint][direction] for joint, direction in _LENGTHENS]) * rng.standard_normal(
        (n, len(_LENGTHENS))
    )
    added = np.array([[effect.get(s, 0.0) for s in SEGMENT_ENDS] for effect in _LENGTHENS.values()])
    gain, covariance = conditional_offsets(known)
    left = offsets - (lengths - offsets @ added - share * known.stature_m) @ gain.T
    assert np.abs(left.mean(axis=0)).max() < 5e-4
    nees = np.einsum("ni,ij,nj->n", left, np.linalg.inv(covariance), left).mean()
    assert nees == pytest.approx(len(_LENGTHENS), rel=0.02)
    stated = [offset_sigma_m()[joint][direction] for joint, direction in _LENGTHENS]
    assert left.std(axis=0) == pytest.approx(stated, rel=0.03)


def test_arms_that_come_out_short_are_put_right(table):
    truth = person(LENGTHS)
    marked = too_close(truth, wrist_m=0.09, elbow_m=0.045)
    moved = to_joint_centres(sequence(marked), table).xyz_world[:, 0]
    assert error_m(moved, truth, "elbow") < 0.5 * error_m(marked, truth, "elbow")
    assert error_m(moved, truth, "wrist") < 0.5 * error_m(marked, truth, "wrist")


def test_who_has_usual_proportions_and_a_good_detector_stays(table):
    usual = person(dict(table.lengths))
    moved = to_joint_centres(sequence(usual), table).xyz_world[:, 0]
    assert np.nanmax(np.abs(moved - usual)) < 1e-6
    tall = person({segment: 1.1 * length for segment, length in table.lengths.items()})
    off = np.linalg.norm(to_joint_centres(sequence(tall), table).xyz_world[:, 0] - tall, axis=-1)
    assert np.nanmax(off) < 0.01


def test_unusual_people_are_not_moved_by_more_than_is_reported(table):
    truth = person(LENGTHS)
    moved = to_joint_centres(sequence(truth), table).xyz_world[:, 0]
    sigma = max(value for directions in offset_sigma_m().values() for value in directions.values())
    assert np.nanmax(np.linalg.norm(moved - truth, axis=-1)) < 2.5 * sigma


@pytest.mark.parametrize("name", ["anatomical23", "paper14", "blazepose33"])
def test_sets_that_are_joint_centres_or_have_tables_get_none(name):
    assert proportional_joint_centres(SKELETONS[name]) is None


@pytest.mark.parametrize("name", ["coco17", "body_25", "body_25b", "halpe_26", "coco_wholebody_133", "halpe_136"])
def test_every_marked_set_has_one(name):
    table = proportional_joint_centres(SKELETONS[name])
    assert table is not None and name in table.made_by and set(table.lengths) == set(SEGMENT_ENDS)
