"""A rendered session on disk: what is in it, that it repeats, that it survives interruption."""

import re
import signal
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from checks import refusal
from running import printed
from scenes import scene

from posefuse.core import SE3, InputError, SourceError
from posefuse.core.ideal_image import SourceView, optics_of
from posefuse.core.skeleton import ANATOMICAL23
from posefuse.formats.npz import read_arrays
from posefuse.formats.rig import read_rig
from posefuse.formats.truth import read_truth
from posefuse.formats.video import VideoWriter
from posefuse.foundation.output_folder import MARK_FILE, find_unfinished
from posefuse.sources.images import ImagesConfig
from posefuse.sources.video import VideoConfig
from posefuse_sim import read_scene, simulate, truth_of
from posefuse_sim import session as sessions
from posefuse_sim.build import live_scene
from posefuse_sim.render.model import render_model
from posefuse_sim.render.shot import body_poses
from posefuse_sim.render.stage import RenderStage
from posefuse_sim.render.workers import children_ignore_requests
from posefuse_sim.source import SimulatedConfig

pytestmark = pytest.mark.gl

_RING = {"kind": "ring", "count": 3, "radius_m": 3.0, "image": {"size_px": [200, 150]}, "sensor": {"noise_dn": 2.0}}
_OTHER = {
    "roll_deg": 15,
    "image": {"size_px": [160, 120], "horizontal_fov_deg": 75, "distortion": [-0.2, 0.05, 0.001, 0.0]},
    "sensor": {"rate_hz": 20, "offset_s": 0.3, "jitter_s": 0.003, "drop_fraction": 0.1},
}
_IDLE = {"motion": {"kind": "idle", "position_m": [0.3, 0.2], "heading_deg": 40}}
_CONTENT = {"duration_s": 0.5, "start_s": 1.0, "rate_hz": 10, "seed": 5, "cameras": {**_RING, "overrides": {"cam01": _OTHER}}}
_ONE_CAMERA = {"kind": "ring", "count": 1, "radius_m": 3.0, "first_angle_deg": 0}
_SCENE = scene(
    **_CONTENT,
    people=[_IDLE, {"motion": {"kind": "tpose", "position_m": [-0.7, -0.3]}}],
    occluders=[{"kind": "box", "position_m": [1.2, 0.6, 0.5], "size_m": [0.3, 0.5, 1.0]}],
    props=[{"kind": "aruco_cube", "path": {"kind": "waved", "centre_m": [-0.7, 0.4, 1.1], "extent_m": [0.1, 0.2, 0.3]}}],
)


@pytest.fixture(scope="module")
def session(tmp_path_factory, backend) -> Path:
    folder = tmp_path_factory.mktemp("simulated") / "session"
    simulate(_SCENE, folder, processes=1)
    return folder


def test_videos_carry_the_cameras_own_times_and_the_truth_the_true_ones(session):
    truth = read_truth(session / "truth" / "truth.npz")
    shots = read_arrays(session / "truth" / "shots.npz")
    for i, view in enumerate(truth.views):
        film = VideoConfig(session / "videos" / f"{view.camera}.mp4", view.camera).build()
        assert film.size_wh == truth.rig.cameras[i].size_wh
        stamps = np.array([frame.t_ns for frame in film.frames()])
        np.testing.assert_allclose(stamps, shots[f"stamp{i}_ns"], atol=501)
        np.testing.assert_array_equal(view.t_ns, shots[f"t{i}_ns"])
    offset_s = (shots["stamp1_ns"] - shots["t1_ns"]) / 1e9
    np.testing.assert_allclose(offset_s, 0.3, atol=1e-8)


def test_a_finished_session_holds_its_rig_and_its_scene_and_nothing_unfinished(session):
    assert read_rig(session / "rig.toml").id == read_truth(session / "truth" / "truth.npz").rig.id
    assert read_scene(session / "scene.yaml") == _SCENE
    assert sorted(path.name for path in session.iterdir()) == [MARK_FILE, "rig.toml", "scene.yaml", "truth", "videos"]


def test_truth_without_rendering_differs_in_visibility_only(session):
    rendered, quick = read_truth(session / "truth" / "truth.npz"), truth_of(_SCENE)
    np.testing.assert_array_equal(rendered.xyz_world, quick.xyz_world)
    np.testing.assert_array_equal(rendered.joints.angle_rad, quick.joints.angle_rad)
    for a, b in zip(rendered.views, quick.views, strict=True):
        np.testing.assert_array_equal(a.xy_img, b.xy_img)
    # capsules are not a mesh, and the quick truth lets the cube hide nothing
    agree = np.concatenate([(a.visible == b.visible).ravel() for a, b in zip(rendered.views, quick.views, strict=True)])
    assert agree.mean() > 0.85


def _people_drawn(stage: RenderStage, view: SourceView, cam_from_world: SE3) -> np.ndarray:
    """(h, w) number of the person seen in each pixel, -1 where there is none: MuJoCo's segmentation of skins."""
    mujoco, scene = stage._mujoco, stage._scene
    before = scene.flags.copy()
    scene.flags[[mujoco.mjtRndFlag.mjRND_SEGMENT.value, mujoco.mjtRndFlag.mjRND_IDCOLOR.value]] = 1
    rectangle, rgb = stage._aim(view, cam_from_world), np.empty((view.height, view.width, 3), np.uint8)
    mujoco.mjr_render(rectangle, scene, stage._drawing)
    mujoco.mjr_readPixels(rgb, None, rectangle, stage._drawing)
    scene.flags[:] = before
    person = np.full(scene.ngeom + 1, -1)
    for geom in scene.geoms[: scene.ngeom]:
        if geom.segid >= 0 and geom.objtype == mujoco.mjtObj.mjOBJ_SKIN:
            name = mujoco.mj_id2name(stage._model, mujoco.mjtObj.mjOBJ_SKIN, geom.objid)
            person[geom.segid + 1] = int(name.split("_")[0].removeprefix("p"))
    return person[rgb[::-1].astype(np.int32) @ np.array([1, 256, 65536], np.int32)]


def test_visible_joints_lie_on_their_person_and_hidden_ones_exist(session, backend):
    live, truth = live_scene(_SCENE), read_truth(session / "truth" / "truth.npz")
    stage = RenderStage(render_model(live, live.rig, backend), backend)
    inside = []
    for camera, view in zip(live.rig, truth.views, strict=True):
        lens = optics_of(camera)
        for f, t_ns in enumerate(view.t_ns):
            stage.place(body_poses(live, np.array([t_ns / 1e9]))[0])
            people = _people_drawn(stage, lens.view, camera.cam_from_world)
            # a margin of a pixel: joints at the silhouette's edge fall between pixels
            masks = [cv2.dilate((people == n).astype(np.uint8), np.ones((3, 3))) for n in range(2)]
            for n in range(2):
                norm = camera.norm_from_px(view.xy_img[f, n][view.visible[f, n]])
                column, row = np.round(lens.view.px_from_norm(norm)).astype(int).T
                inside += list(masks[n][row, column])
    stage.close()
    assert len(inside) > 400
    assert np.mean(inside) == 1.0
    assert 0.05 < np.mean([~view.visible for view in truth.views[:1]]) < 0.8


def test_a_joint_behind_the_box_is_hidden_and_the_same_joint_without_the_box_is_not(shots):
    alone = {**_CONTENT, "people": [_IDLE], "cameras": {**_ONE_CAMERA, "image": {"size_px": [160, 120]}}}
    wall = {"kind": "box", "position_m": [1.3, 0.1, 0.6], "size_m": [0.1, 2.4, 1.2]}
    shown, hidden = (shots(scene(**alone, occluders=boxes))[1][0].visible for boxes in ([], [wall]))
    knees = ANATOMICAL23.indices(["left_knee", "right_knee"])
    assert shown[knees].all() and not hidden[knees].any()
    assert shown[ANATOMICAL23.index("nose")] and hidden[ANATOMICAL23.index("nose")]


def _contents(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


@pytest.mark.slow
def test_the_same_seed_gives_the_same_bytes_with_any_number_of_processes_and_after_an_interruption(session, tmp_path):
    class Interruption(Exception):
        pass

    def interrupt(done: int, total: int) -> None:
        if 0 < done < total:
            raise Interruption

    calls = []
    folder = tmp_path / "again"
    with pytest.raises(Interruption):
        simulate(_SCENE, folder, interrupt, processes=2)
    assert not folder.exists() and len(find_unfinished(folder)) == 1
    simulate(_SCENE, folder, lambda done, total: calls.append((done, total)), processes=2)
    first, total = calls[0]
    assert 0 < first < total and calls[-1] == (total, total)
    assert _contents(folder) == _contents(session)


def test_a_session_of_its_own_is_replaced_and_what_is_the_users_stays(tmp_path, backend):
    content = {**_CONTENT, "record": {"kind": "jpeg"}, "cameras": {**_ONE_CAMERA, "image": {"size_px": [80, 60]}}}
    other, made = (scene(**{**content, "duration_s": duration_s}) for duration_s in (0.2, 0.1))
    folder = tmp_path / "session"

    def interrupt(done: int, total: int) -> None:
        raise KeyboardInterrupt

    # of another scene, unfinished: not mixed with this one, named and kept
    with pytest.raises(KeyboardInterrupt):
        simulate(other, folder, interrupt, processes=1)
    [unfinished] = find_unfinished(folder)
    kept = _contents(unfinished)
    with pytest.warns(UserWarning, match=f"{re.escape(str(unfinished))}: is an unfinished session of another scene"):
        simulate(made, folder, processes=1)
    # finished: moved aside, with what the user put there, and kept
    before = _contents(folder)
    refusal(InputError, "holds results already", simulate, made, folder)
    (folder / "notes.txt").write_text("the user's")
    with pytest.warns(UserWarning) as said:
        simulate(made, folder, processes=1, replace=True)
    assert _contents(folder) == before
    [aside] = tmp_path.glob("session.replaced-*")
    assert str(said[-1].message).endswith(f"the earlier results are kept in {aside}")
    assert (aside / "notes.txt").read_text() == "the user's" and set(_contents(aside)) == {*before, "notes.txt"}
    # interrupted: the finished one stays in its place until the new one is whole
    with pytest.raises(KeyboardInterrupt):
        simulate(made, folder, interrupt, processes=1, replace=True)
    assert _contents(folder) == before and len(find_unfinished(folder)) == 2
    simulate(made, folder, processes=1, replace=True)
    assert find_unfinished(folder) == [unfinished] and _contents(unfinished) == kept


def test_motion_files_count_from_the_scene_file_and_a_session_finds_them_again(tmp_path):
    person = {"motion": {"kind": "trc", "file": "walk.trc"}}
    (tmp_path / "scene.yaml").write_text(yaml.safe_dump({**_CONTENT, "people": [person, person]}))
    read = read_scene(tmp_path / "scene.yaml")
    assert read.people[0].motion.file == str(tmp_path / "walk.trc")
    (tmp_path / "session").mkdir()
    sessions._begin(sessions.SessionPaths(tmp_path / "session"), read)
    assert read_scene(tmp_path / "session" / "scene.yaml") == read


def test_image_folders_are_read_with_their_times(tmp_path, backend):
    made = scene(**{**_CONTENT, "record": {"kind": "jpeg"}, "duration_s": 0.3})
    paths = simulate(made, tmp_path / "images", processes=1)
    frames = list(ImagesConfig(paths.videos / "cam01", "cam01").build().frames())
    stamps = read_arrays(paths.shots)["stamp1_ns"]
    np.testing.assert_allclose([frame.t_ns for frame in frames], stamps, atol=1)
    assert frames[0].size_wh == (160, 120)


def test_a_program_without_a_main_guard_simulates(tmp_path, backend):
    """Its processes ran the whole program again, which failed in each of them, and it waited for them without end."""
    (tmp_path / "scene.yaml").write_text(yaml.safe_dump({**_CONTENT, "cameras": _ONE_CAMERA, "duration_s": 0.2}))
    (tmp_path / "program.py").write_text('import posefuse as pf\nprint(pf.simulate("scene.yaml", "session", processes=1))\n')
    assert printed(str(tmp_path / "program.py"), cwd=tmp_path).count("\n") == 1
    assert len(list((tmp_path / "session" / "videos").iterdir())) == 1


def test_a_live_camera_gives_what_the_video_shows_with_the_numbers_and_stamps_of_its_frames(session):
    shots = read_arrays(session / "truth" / "shots.npz")
    for i, camera in enumerate(("cam00", "cam01", "cam02")):
        played = list(SimulatedConfig(session, camera, paced=False).build().frames())
        video = VideoConfig(session / "videos" / f"{camera}.mp4", camera).build().frames()
        assert [frame.seq for frame in played] == shots[f"seq{i}"].tolist()
        assert [frame.t_ns for frame in played] == shots[f"stamp{i}_ns"].tolist()
        assert all(np.array_equal(one.image, other.image) for one, other in zip(played, video, strict=True))


def test_a_paced_camera_never_gives_a_frame_before_its_time(session):
    frames = list(SimulatedConfig(session, "cam00").build().frames())
    assert frames and all(frame.received_ns >= frame.t_ns for frame in frames)


def test_an_unknown_camera_is_refused_with_the_names_there_are(session):
    refusal(SourceError, "no camera 'cam7'; there are: cam00, cam01, cam02", lambda: SimulatedConfig(session, "cam7").build())


def test_a_scene_is_no_camera_until_it_is_rendered(session):
    scene_file = session / "scene.yaml"
    message = r"scene\.yaml: expected the folder of a session; of a scene: `posefuse simulate SCENE\.yaml --out SESSION`"
    refusal(SourceError, message, SimulatedConfig.cameras, scene_file)
    refusal(SourceError, message, SimulatedConfig(scene_file, "cam00").build)


def test_joined_parts_are_all_frames_at_their_times(tmp_path: Path) -> None:
    t_ns, greys = 700_207_000 + np.arange(9) * 33_333_000, 20 + 23 * np.arange(9)
    parts = [tmp_path / f"{i}.mp4" for i in range(3)]
    for part, frames in zip(parts, (range(4), range(4, 5), range(5, 9)), strict=True):
        with VideoWriter(part, (96, 64), 30.0, 8) as writer:
            for i in frames:
                writer.write(np.full((64, 96, 3), greys[i], np.uint8), int(t_ns[i]))
    sessions.join_videos(parts, tmp_path / "all.mp4")
    read = list(VideoConfig(tmp_path / "all.mp4", "cam").build().frames())
    np.testing.assert_allclose([frame.t_ns for frame in read], t_ns, atol=501)
    np.testing.assert_allclose([frame.image.mean() for frame in read], greys, atol=4)
    (tmp_path / "text.mp4").write_text("no video")
    refusal(InputError, "cannot be joined", sessions.join_videos, [tmp_path / "text.mp4"], tmp_path / "other.mp4")


def test_a_process_ignores_ctrl_c_from_its_first_moment() -> None:
    """What it imports before its own first line could not handle it, and would be printed as a trace."""
    signal.signal(signal.SIGINT, signal.default_int_handler)
    with ProcessPoolExecutor(1, get_context("spawn")) as other:
        with children_ignore_requests():
            asked = other.submit(signal.getsignal, signal.SIGINT)
        assert asked.result(60) == signal.SIG_IGN
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
