"""The asynchronous tracker: right at the time it is asked for, honest about it, and not misled."""

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from built import without
from checks import refusal

from posefuse.association import AssociateSettings, associate
from posefuse.core import Kind, ShapeError
from posefuse.core.skeleton import BODY_25, COCO17, SKELETONS
from posefuse.formats.rig import read_rig
from posefuse.fusion import FuseSettings, fuse
from posefuse.tracking.online import LiveSettings, Model, Tracker
from posefuse.tracking.online import person as of_one_person
from posefuse.tracking.online.cross_check import CrossCheck
from posefuse.tracking.settings import LASTING_S, LASTING_SHARE
from posefuse.tracking.warm_up import made_up_detections

LATE_S = 0.07
# where no error lasts from frame to frame
FRESH = {"lasting_share": 0.0, "new_share": 1.0}


def run(world, views, seconds, from_s=0.5, late_s=LATE_S, **settings):
    """Poses at 100 Hz from `from_s` on, every view coming late_s late."""
    tracker, poses, waiting = world.tracker(**settings), [], list(views)
    for tick in range(int(seconds * 100)):
        t_ns = tick * 10_000_000
        while waiting and waiting[0].t_ns + late_s * 1e9 <= t_ns:
            tracker.add(waiting.pop(0))
        pose = tracker.at(t_ns)
        if t_ns >= from_s * 1e9:
            poses.append(pose)
    return tracker, poses


def mean_error_m(world, poses):
    return float(np.nanmean([world.error_m(pose) for pose in poses]))


def test_a_walking_person_is_where_the_truth_is_at_output_time(world):
    w = world()
    _, poses = run(w, w.views(2.2), 2.2)
    assert all(pose.person_id.tolist() == [0] for pose in poses)
    assert mean_error_m(w, poses) < 0.04


def test_a_person_at_rest_is_where_the_truth_is(world):
    """With errors as the default network has them on people who stand."""
    w = world(motion="stand")
    rngs = (np.random.default_rng(seed) for seed in range(3))
    views = (with_errors(w.views(2.0, seed=None), rng, WANDERING_AT_REST, NEW_AT_REST) for rng in rngs)
    assert np.mean([mean_error_m(w, run(w, one, 2.0)[1]) for one in views]) < 0.0186


# of the stated variance, what is new in every view and what wanders; the rest stays. As `bench/fit_tracker.py --rest` prints it
NEW_AT_REST, WANDERING_AT_REST = (0.35 / 2.0) ** 2, (0.6 / 2.0) ** 2


def with_errors(views, rng, wander=LASTING_SHARE, new=1 - LASTING_SHARE):
    """Noise of the stated size: a share that wanders for `LASTING_S`, one that is new, and a constant of every camera."""
    constant, wandering, noisy = {}, {}, []
    for view in views:
        fresh = rng.standard_normal(view.xy_img.shape)
        lasting = constant.setdefault(view.camera, rng.standard_normal(view.xy_img.shape))
        before_ns, slow = wandering.get(view.camera, (view.t_ns, fresh))
        keep = np.exp(-(view.t_ns - before_ns) * 1e-9 / LASTING_S)
        slow = keep * slow + np.sqrt(1 - keep**2) * fresh
        wandering[view.camera] = view.t_ns, slow
        white = rng.standard_normal(view.xy_img.shape)
        errors = np.sqrt(max(1 - new - wander, 0)) * lasting + np.sqrt(wander) * slow + np.sqrt(new) * white
        noisy.append(replace(view, xy_img=view.xy_img + errors * view.sigma_px[..., None]))
    return noisy


@pytest.mark.parametrize("cameras", [2, 4])
def test_a_view_of_a_followed_person_costs_one_step_of_the_kernels_and_no_association(world, monkeypatch, cameras):
    """What the speed of live tracking rests on: a count, so it holds on every machine."""
    scene = world(cameras)
    steps, solved, checked = [], [], []

    def solve(together):
        solved.append(together)
        return fuse(associate(together, scene.rig, AssociateSettings()), scene.rig, FuseSettings())

    def fuse_again(views):
        checked.append(views)
        return scene.fuse(views)

    monkeypatch.setattr(of_one_person, "step", lambda *given, work=of_one_person.step: steps.append(given) or work(*given))
    tracker = Tracker(Model(scene.rig, COCO17, LiveSettings()), solve, fuse_again, scene.whitened)
    for view in scene.views(3.0):
        before, followed = (len(steps), len(solved)), len(tracker.at(view.t_ns).person_id) > 0
        tracker.add(view)
        tracker.at(view.t_ns)
        if followed:
            assert (len(steps), len(solved)) == (before[0] + 1, before[1])
    views = 3 * 30 * cameras
    assert len(solved) <= 2 and views - 3 * cameras <= len(steps) <= views
    # two cameras cannot show which of them is wrong; more are fused afresh some ten times a second, not with every view
    assert (0 < len(checked) < views / 6) if cameras > 2 else not checked


def test_what_the_whole_body_does_is_learnt_from_all_keypoints_together(world):
    """In free fall all accelerate alike: the vertical speed is known many times better than from one keypoint's views."""
    stand = world(motion="stand").place(0)

    def leap(t_s):
        t = np.mod(t_s, 1.0)
        return stand + np.array([0.0, 0.0, 1.0]) * np.where(t < 0.5, 2.45 * t - 9.81 * t**2 / 2, 0.0)

    w = world(motion=leap)
    shown = COCO17.indices(("nose", "left_wrist", "right_hip"))
    others = np.setdiff1d(np.arange(len(COCO17)), shown)
    together, alone = [], []
    for seed in range(3):
        views = w.views(2.2, seed)
        # born of the whole person
        few = [view if view.t_ns < 0.3e9 else without(view, others) for view in views]
        for come, errors in ((views, together), (few, alone)):
            errors += [w.error_m(pose)[shown].mean() for pose in run(w, come, 2.2, from_s=1.0)[1]]
    assert np.nanmean(together) < 0.9 * np.nanmean(alone)


def test_exact_views_of_steady_motion_leave_nothing_but_rounding(world):
    stand = world(motion="stand").place(0)
    w = world(motion=lambda t_s: stand + np.array([0.8, 0.3, 0.0]) * (t_s - 1.0))
    _, poses = run(w, w.views(2.0, seed=None), 2.0, from_s=1.5)
    assert np.nanmax([w.error_m(pose) for pose in poses]) < 0.01


# at rest it always reckons with a movement about to begin, so it states more than it errs
@pytest.mark.parametrize(
    ("lasting", "motion", "least", "most"),
    [(False, "stand", 0.75, 3.0), (False, "walk", 1.5, 4.5), (True, "stand", 1.5, 4.5), (True, "walk", 1.5, 4.5)],
)
def test_covariance_is_honest_about_errors_that_last_as_the_settings_say_and_about_new_ones(world, lasting, motion, least, most):
    w = world(motion=motion)
    nees = []
    for seed in range(3):
        exact = w.views(2.2, seed=None)
        views = with_errors(exact, np.random.default_rng(seed)) if lasting else w.views(2.2, seed)
        for pose in run(w, views, 2.2, **({} if lasting else FRESH))[1][::5]:
            error = pose.xyz_world[0] - w.place(pose.t_ns / 1e9)
            nees += list(np.einsum("ki,kij,kj->k", error, np.linalg.inv(pose.cov_world[0]), error))
    assert least < np.mean(nees) < most


def test_who_moved_lately_is_expected_to_move_again(world):
    """Both stand still now; what may begin before the next view tells of itself is as strong as what there was lately."""
    stand = world(motion="stand").place(0)

    def shaken(t_s):
        return stand + np.array([0.12, 0.0, 0.0]) * np.sin(2 * np.pi * 1.5 * min(t_s, 2.0))

    wide = {}
    for name, motion in (("moved", shaken), ("stood", lambda t_s: stand)):
        w = world(motion=motion)
        tracker, _ = run(w, w.views(2.6), 2.6, late_s=0.0)
        now, ahead = (tracker.at(t_ns).cov_world[0] for t_ns in (2_600_000_000, 2_700_000_000))
        wide[name] = [np.sqrt(np.trace(cov, axis1=-2, axis2=-1).mean()) for cov in (now, ahead)]
    assert wide["moved"][0] < 1.2 * wide["stood"][0]
    assert wide["moved"][1] > 1.2 * wide["stood"][1]


def test_one_camera_alone_helps_and_is_unsure_along_its_rays(world):
    w = world()
    views = w.views(2.2)
    late_views = [v for v in views if v.t_ns < 1e9 or v.camera == "cam00"]
    _, alone = run(w, late_views, 1.8)
    _, blind = run(w, [v for v in views if v.t_ns < 1e9], 1.8)
    at = -20
    assert np.nanmedian(w.error_m(alone[at])) < np.nanmedian(w.error_m(blind[at]))
    wide = np.linalg.eigh(alone[at].cov_world[0])
    ray = alone[at].xyz_world[0] - w.rig.cameras[0].centre_world
    ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
    assert np.median(np.abs((wide.eigenvectors[:, :, 2] * ray).sum(-1))) > 0.9
    sigmas = [np.sqrt(np.median(np.linalg.eigvalsh(pose.cov_world[0])[:, 2])) for pose in (alone[55], alone[80], alone[105])]
    assert sigmas[0] < sigmas[1] < sigmas[2]


def test_without_views_it_grows_unsure_then_lets_go(world):
    w = world()
    tracker, _ = run(w, w.views(1.0), 1.1, lost_after_s=0.6)
    poses = [tracker.at(round(t_s * 1e9)) for t_s in (1.05, 1.2, 1.4, 1.55)]
    traces = [np.trace(pose.cov_world[0], axis1=-2, axis2=-1) for pose in poses]
    assert all((b > a).all() for a, b in pairwise(traces))
    assert (poses[0].kind == Kind.FUSED).all()
    assert (poses[0].n_views[0] == 4).all()
    assert (poses[-1].kind == Kind.PREDICTED).all()
    assert np.isnan(poses[-1].reproj_px).all()
    assert len(tracker.at(1_800_000_000).person_id) == 0


def test_swapped_views_are_put_right(world, sides_swapped):
    w = world()
    views = [sides_swapped(v) if v.camera == "cam01" else v for v in w.views(2.0)]
    # born of the first two views, one of them swapped, the person may have to be turned round first
    _, poses = run(w, views, 2.0, from_s=0.7)
    _, clean = run(w, w.views(2.0), 2.0, from_s=0.7)
    assert mean_error_m(w, poses) < 1.1 * mean_error_m(w, clean)


def test_a_person_who_was_born_mirrored_is_turned_round(world, sides_swapped):
    w = world()
    views = [sides_swapped(v) if v.t_ns < 3e8 else v for v in w.views(2.2)]
    _, poses = run(w, views, 2.2)
    assert np.nanmax(w.error_m(poses[-1])) < 0.1


def test_a_camera_that_was_knocked_cannot_pull_and_is_named(world):
    w = world()
    knocked = world(motion=lambda t_s: w.place(t_s) + (0.0, 0.45, 0.3))
    views = [knocked.view(2, v.t_ns / 1e9, np.random.default_rng(i)) if v.camera == "cam02" else v
             for i, v in enumerate(w.views(2.0))]  # fmt: skip
    tracker, poses = run(w, views, 2.0, **FRESH)
    _, without = run(w, [v for v in w.views(2.0) if v.camera != "cam02"], 2.0, **FRESH)
    assert mean_error_m(w, poses) < 1.15 * mean_error_m(w, without)
    health = tracker.health
    # none of its views found the person, or most of its keypoints were too far off
    assert np.isnan(health["cam02"].innovation_sigmas) or health["cam02"].gated_share > 0.5
    assert health["cam00"].gated_share < 0.05
    assert health["cam00"].innovation_sigmas < 1.3


def test_wild_keypoints_do_not_pull(world):
    w = world()
    rng = np.random.default_rng(5)
    views = []
    for v in w.views(2.0):
        xy = v.xy_img.copy()
        wild = rng.random(len(COCO17)) < 0.08
        xy[0, wild] += rng.uniform(-120, 120, (int(wild.sum()), 2))
        views.append(replace(v, xy_img=xy))
    _, poses = run(w, views, 2.0)
    _, clean = run(w, w.views(2.0), 2.0)
    assert mean_error_m(w, poses) < 1.35 * mean_error_m(w, clean)


def test_two_people_keep_their_names_and_a_bystander_has_none(world, detections_of):
    w = world(motion="stand")
    body = w.place(0)
    places = [body + (0.0, -0.9, 0.0), body + (0.0, 0.9, 0.0), body + (1.6, 0.0, 0.0)]
    rng = np.random.default_rng(2)
    views = []
    for v in w.views(1.5):
        c = w.rig.names.index(v.camera)
        shown = [w.rig.cameras[c].project(p) + rng.normal(0, 2, (len(COCO17), 2)) for p in places]
        order = rng.permutation(2 if v.t_ns < 0.3e9 else 3)
        views.append(detections_of(v.camera, v.t_ns / 1e9, *(shown[i] for i in order)))
    _, poses = run(w, views, 1.5, max_people=2)
    centres = np.array([np.nanmean(pose.xyz_world, axis=1) for pose in poses])
    assert centres.shape[1] == 2
    assert (np.ptp(centres, axis=0) < 0.05).all()
    assert sorted(np.sign(centres[0, :, 1])) == [-1, 1]


@pytest.mark.parametrize("first", range(4))
def test_who_is_seen_once_by_two_synchronised_cameras_is_found_whichever_camera_comes_next(world, detections_of, first):
    """As whole images are searched now and then, a person who is not followed is seen in single frames."""
    w = world(motion="stand")
    places = [w.place(0), w.place(0) + (0.0, 1.5, 0.0)]
    tracker = w.tracker(max_people=2)
    for i in range(8):
        for c in np.roll(range(4), -first if i == 7 else 0):
            people = places if i == 6 and c < 2 else places[:1]
            camera = w.rig.cameras[c]
            tracker.add(detections_of(camera.name, i / 30, *(camera.project(xyz) for xyz in people)))
    assert len(tracker.at(round(7 / 30 * 1e9)).person_id) == 2


@pytest.mark.parametrize("blind", [False, True])
def test_who_several_cameras_see_takes_the_place_of_a_track_that_none_or_one_alone_sees(world, detections_of, blind):
    w = world(5, "stand")
    was, moved = w.place(0) + (0.0, 1.5, 0.0), w.place(0) + (0.0, -1.5, 0.0)

    def view(c, t_s):
        camera = w.rig.cameras[c]
        # from half a second on camera 0 goes on seeing a body where the others see none, or sees no person
        other = was if t_s < 0.5 or c == 0 else moved
        people = [w.place(0)] if c == 0 and blind and t_s >= 0.5 else [w.place(0), other]
        return detections_of(camera.name, t_s, *(camera.project(xyz) for xyz in people))

    tracker = w.fed([view(c, (i + c / 5) / 30) for i in range(30) for c in range(5)], max_people=2)
    pose = tracker.at(10**9)
    nearest = [np.linalg.norm(pose.xyz_world - xyz, axis=-1).mean(axis=-1).min() for xyz in (w.place(0), moved)]
    assert len(pose.person_id) == 2
    assert max(nearest) < 0.05


def test_bent_lenses_are_undone(world):
    w = world(distortion=(-0.25, 0.08, 0.001, -0.002, 0.0))
    _, poses = run(w, w.views(2.0), 2.0)
    straight = world()
    _, plain = run(straight, straight.views(2.0), 2.0)
    assert mean_error_m(w, poses) < 1.2 * mean_error_m(straight, plain)


def test_unknown_cameras_and_other_skeletons_are_named(world, detections_of):
    w = world()
    tracker = w.tracker()
    with pytest.raises(ShapeError, match=r"no camera 'cam9' in the rig; there are: cam00, cam01"):
        tracker.add(detections_of("cam9", 0.0, np.zeros((17, 2))))
    other = type(w.view(0, 0.0)).empty("cam00", 0, BODY_25)
    refusal(ShapeError, "camera cam00: expected skeleton coco17, got body_25", tracker.add, other)


# --- a keypoint that follows something else does not leave the body


_REACH_M = 1.7  # of `tracking.online.kernels.body`: no keypoint of a body is further from its middle


def test_a_keypoint_that_follows_a_passing_object_comes_back(world):
    wrist, away_s, speed_m_s = COCO17.index("left_wrist"), 1.0, 2.5
    still = world(motion="stand").place

    def carried_off(t_s: float) -> np.ndarray:
        """The wrist goes with an object that passes the hand and moves on."""
        xyz = still(t_s)
        xyz[wrist] += (0.0, speed_m_s * max(t_s - away_s, 0.0), 0.0)
        return xyz

    w = world(motion=carried_off)
    tracker, apart_m = w.tracker(), {}
    for view in w.views(2.6):
        tracker.add(view)
        pose = tracker.at(view.t_ns)
        if view.t_ns > 0.5e9 and len(pose.person_id):
            middle = np.nanmedian(pose.xyz_world[0], axis=0)
            apart_m[view.t_ns] = np.linalg.norm(pose.xyz_world[0, wrist] - middle)
    times, apart = np.array(list(apart_m)), np.array(list(apart_m.values()))
    assert np.nanmax(apart[times < 1.6e9]) > 1.0, "the wrist is carried off at first: the scene is hard enough"
    # the object is 2.5 m away by then; the first estimates after the drop may still be wide of the body
    settled = apart[times > 2.0e9]
    assert np.isfinite(settled).mean() > 0.7
    assert np.nanmax(settled) < _REACH_M


# --- the person whom the pipeline processes beforehand is taken for one, however few the cameras


RIG = read_rig(Path(__file__).resolve().parents[2] / "examples" / "demo" / "rig.toml")


@pytest.mark.parametrize("cameras", [2, 4])
@pytest.mark.parametrize("skeleton", ["coco17", "body_25", "blazepose33", "halpe_26", "coco_wholebody_133"])
def test_the_made_up_person_is_found_by_two_cameras_and_by_four(skeleton: str, cameras: int) -> None:
    rig = RIG.only(RIG.names[:cameras])
    # in the second time step the first camera contradicts the others, which two cameras do not survive
    for views in list(made_up_detections(rig, SKELETONS[skeleton], 5))[:: 2 if cameras == 2 else 1]:
        together = [replace(view, t_ns=0) for view in views]
        assert np.array_equal(associate(together, rig, AssociateSettings(), None).person_id, [0])


# --- what began with wrong views is corrected by the cameras that agree: keypoints, and left and right


WRIST = COCO17.index("left_wrist")
ARMS = [COCO17.index(f"{side}_{joint}") for side in ("left", "right") for joint in ("shoulder", "elbow", "wrist")]
BEGIN_S, END_S = 0.6, 2.2
WRONG_PX = np.array([60.0, 35.0])


def errors_of(w, changed, keypoints):
    """Largest error of some keypoints by time in s, for views as `changed` makes them."""
    tracker, errors = w.tracker(), {}
    for view in w.views(END_S):
        tracker.add(changed(view))
        pose = tracker.at(view.t_ns)
        if len(pose.person_id):
            errors[view.t_ns * 1e-9] = w.error_m(pose)[keypoints].max()
    return errors


def test_cameras_that_agree_correct_a_keypoint_that_began_with_a_wrong_view(world):
    """The first camera takes something else for the wrist throughout; two others see the wrist after `BEGIN_S` only."""
    w = world(cameras=4, motion="stand")
    first, _, *others = w.rig.names

    def changed(view):
        hidden = view.camera in others and view.t_ns < BEGIN_S * 1e9
        return wrong_wrist(view) if view.camera == first else without(view, [WRIST]) if hidden else view

    errors = errors_of(w, changed, [WRIST])
    before = [error for t_s, error in errors.items() if 0.3 < t_s < BEGIN_S]
    after = [error for t_s, error in errors.items() if t_s > BEGIN_S + 0.7]
    assert np.min(before) > 0.2, "the scene is hard enough: the wrong view counted"
    assert np.median(after) < 0.05
    assert np.isfinite(after).all()


def test_arms_that_began_swapped_are_put_right(world):
    """Two cameras swap the arms for good; the others see none until `BEGIN_S`, so that the person begins swapped."""
    w = world(cameras=5, motion="stand")
    wrong = w.rig.names[:2]

    def changed(view):
        hidden = view.t_ns < BEGIN_S * 1e9
        return swapped(view, ARMS) if view.camera in wrong else without(view, ARMS) if hidden else view

    errors = errors_of(w, changed, ARMS)
    assert np.max([error for t_s, error in errors.items() if t_s < BEGIN_S]) > 0.2, "the scene is hard enough"
    after = [error for t_s, error in errors.items() if t_s > BEGIN_S + 1.0]
    assert np.isfinite(after).all()
    assert np.median(after) < 0.05


def test_a_hidden_wrist_does_not_stay_with_the_other_one(world):
    """From `BEGIN_S` on one camera puts the left wrist where the right one is, and no other sees it."""
    w = world(cameras=4, motion="stand")

    def changed(view):
        if view.t_ns <= BEGIN_S * 1e9:
            return view
        return swapped(view, [WRIST]) if view.camera == w.rig.names[0] else without(view, [WRIST])

    errors = errors_of(w, changed, [WRIST])
    # once it is lost (`LiveSettings.lost_after_s`) it does not begin again there
    after = [error for t_s, error in errors.items() if t_s > BEGIN_S + 1.0]
    assert not any(error > 0.2 for error in after)


@pytest.mark.parametrize(("between_outputs", "with_views"), [(True, False), (False, True)])
def test_a_check_is_done_between_outputs_or_else_with_the_next_view(world, monkeypatch, between_outputs, with_views):
    w = world(cameras=4, motion="stand")
    tracker, now, checks = w.tracker(), "", []
    real = CrossCheck.check

    def noted(self, person, t_ns):
        checks.append((now, t_ns))
        real(self, person, t_ns)

    monkeypatch.setattr(CrossCheck, "check", noted)
    for view in w.views(END_S):
        now = "view"
        tracker.add(view)
        tracker.at(view.t_ns)
        now = "between outputs"
        if between_outputs:
            tracker.check()
    assert {when for when, _ in checks} == {"view"} if with_views else {"between outputs"}
    # as often either way
    assert np.diff([t_ns for _, t_ns in checks]).min() >= 200_000_000
    assert len(checks) >= END_S / 0.25


class Tracked:
    """Someone who is tracked at (K, 3) in the world, whatever a check says; what each check said is kept."""

    def __init__(self, xyz):
        self.xyz, self.began_again = xyz, []

    def expected(self, t_ns):
        return self.xyz, np.full(len(self.xyz), 0.01)

    def begin_again(self, xyz):
        self.began_again.append(bool(np.isfinite(xyz).any()))


def checked(world, xyz, steps):
    """`Tracked` at xyz after checks 0.2 s apart: in a step ``all`` cameras see the true body, ``two`` do, or an ``other`` one."""
    standing = world(motion="stand").place(0.0)
    w = world(cameras=4, motion=lambda t_s: standing + (1.0 if steps[round(t_s / 0.2)] == "other" else 0.0))
    check, person = CrossCheck(Model(w.rig, COCO17, LiveSettings()), w.fuse), Tracked(xyz)
    for n, step in enumerate(steps):
        for c in range(2 if step == "two" else 4):
            check.keep(w.view(c, 0.2 * n))
        check.check(person, round(0.2 * n * 1e9))
    return person


@pytest.mark.parametrize("nothing", ["two", "other"])
@pytest.mark.parametrize(("wrong", "checks"), [("wrist", 2), ("arms", 3)])
def test_keypoints_begin_elsewhere_after_some_checks_running_and_a_check_that_found_nothing_ends_a_run(
    world, wrong, checks, nothing
):
    """After two; arms with left and right swapped after three, as networks may swap them for a while."""
    off = world(motion="stand").place(0.0)
    if wrong == "wrist":
        off[WRIST, 2] += 0.3
    else:
        off[ARMS] = off[np.array(COCO17.mirror)[ARMS]]
    not_yet = [False] * (checks - 1)
    assert checked(world, off, ["all"] * checks).began_again == [*not_yet, True]
    # a check that judges nothing changes nothing in the person
    interrupted = ["all"] * (checks - 1) + [nothing] + ["all"] * checks
    assert checked(world, off, interrupted).began_again == [*not_yet, *not_yet, True]


def swapped(view, keypoints):
    xy, mirror = view.xy_img.copy(), np.array(COCO17.mirror)
    xy[:, keypoints] = view.xy_img[:, mirror[keypoints]]
    return replace(view, xy_img=xy)


def wrong_wrist(view):
    xy = view.xy_img.copy()
    xy[:, WRIST] += WRONG_PX
    # it says itself that it is not so sure
    sigma = view.sigma_px.copy()
    sigma[:, WRIST] *= 2
    return replace(view, xy_img=xy, sigma_px=sigma)
