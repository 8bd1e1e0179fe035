"""The same people in every format read back the same; what is none of them lists what was looked for."""

import csv
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from checks import refusal

from posefuse.core import SKELETONS, InputError
from posefuse.formats.pose2d import FORMATS, UNTRACKED, Pose2DFrames, read_pose2d
from posefuse.formats.pose2d.frames import keypoint_name

DATA = Path(__file__).parent / "data"
COCO = SKELETONS["coco17"]
# frames 0, 2, 5: two people, no person, one
NUMBERS, COUNTS = (0, 2, 5), (2, 0, 1)
PEOPLE = [
    np.concatenate([rng.uniform(20, 340, (n, 17, 2)), rng.uniform(0.2, 0.9, (n, 17, 1))], axis=-1)
    for rng, n in ((np.random.default_rng(i), n) for i, n in enumerate(COUNTS))
]
IDS = [[7, 3], [], [3]]
EIGHTEEN = (
    "nose", "neck", "right_shoulder", "right_elbow", "right_wrist", "left_shoulder", "left_elbow", "left_wrist", "right_hip",
    "right_knee", "right_ankle", "left_hip", "left_knee", "left_ankle", "right_eye", "left_eye", "right_ear", "left_ear",
)  # fmt: skip


def flat(person: np.ndarray) -> list[float]:
    return person.ravel().tolist()


def eighteen(person: np.ndarray) -> np.ndarray:
    """OpenPose's COCO order; the neck is the middle of the shoulders."""
    neck = (person[COCO.index("left_shoulder")] + person[COCO.index("right_shoulder")]) / 2
    return np.stack([neck if name == "neck" else person[COCO.index(name)] for name in EIGHTEEN])


def save(path: Path, content: object) -> Path:
    path.write_text(json.dumps(content))
    return path


def openpose(folder: Path, ordered: Callable[[np.ndarray], np.ndarray] = np.asarray) -> Path:
    for number, people in zip(NUMBERS, PEOPLE, strict=True):
        # OpenPose writes no person's hands as empty lists, and now and then a person of none
        listed = [{"pose_keypoints_2d": flat(ordered(p)), "hand_left_keypoints_2d": []} for p in people]
        save(folder / f"cam_{number:012d}_keypoints.json", {"version": 1.3, "people": [*listed, {"pose_keypoints_2d": []}]})
    return folder


def each() -> list[tuple[int, int, np.ndarray]]:
    return [(number, IDS[i][n], person) for i, number in enumerate(NUMBERS) for n, person in enumerate(PEOPLE[i])]


def alphapose_list(folder: Path) -> Path:
    about = {"category_id": 1, "score": 2.9, "box": [1, 2, 3, 4]}
    rows = [{"image_id": f"{n:06d}.jpg", "keypoints": flat(p), "idx": [i], **about} for n, i, p in each()]
    save(folder / "alphapose-results.json", rows)
    return folder


def coco(folder: Path) -> Path:
    rows = [{"image_id": n, "category_id": 1, "keypoints": flat(p), "score": 0.9, "track_id": i} for n, i, p in each()]
    return save(folder / "results.json", rows)


def instances(people: np.ndarray, ids: list[int]) -> list[dict]:
    return [
        {"keypoints": p[:, :2].tolist(), "keypoint_scores": p[:, 2].tolist(), "bbox": [[0, 0, 1, 1]], "track_id": i}
        for p, i in zip(people, ids, strict=True)
    ]


def mmpose_video(folder: Path) -> Path:
    frames = [{"frame_id": n, "instances": instances(people, ids)} for n, people, ids in zip(NUMBERS, PEOPLE, IDS, strict=True)]
    names = {str(k): name for k, name in enumerate(COCO.keypoints)}
    return save(folder / "cam.json", {"meta_info": {"keypoint_id2name": names}, "instance_info": frames})


def mmpose_images(folder: Path) -> Path:
    for n, people, ids in zip(NUMBERS, PEOPLE, IDS, strict=True):
        save(folder / f"{n:012d}.json", instances(people, ids))
    return folder


def in_predictions(write: Callable[[Path], Path]) -> Callable[[Path], Path]:
    """The folder that MMPose's option `out_dir` names, with images of the predictions next to them."""

    def written(folder: Path) -> Path:
        (folder / "predictions").mkdir()
        (folder / "visualizations").mkdir()
        write(folder / "predictions")
        return folder

    return written


def deeplabcut(folder: Path) -> Path:
    people, parts = ("a", "b"), ("x", "y", "likelihood")
    header = [(person, name, part) for person in people for name in COCO.keypoints for part in parts]
    with (folder / "camDLC.csv").open("w", newline="") as file:
        rows = csv.writer(file)
        rows.writerow(["scorer", *(["net"] * len(header))])
        for i, title in enumerate(("individuals", "bodyparts", "coords")):
            rows.writerow([title, *(column[i] for column in header)])
        for number in range(NUMBERS[-1] + 1):
            found = {track: person.ravel().tolist() for n, track, person in each() if n == number}
            rows.writerow([number, *found.get(7, [""] * 51), *found.get(3, [""] * 51)])
    return folder / "camDLC.csv"


# how to write each, and what becomes of the tracks 7 and 3: tables number theirs by place
NUMBERED, BY_PLACE = {7: 7, 3: 3}, {7: 0, 3: 1}
WRITERS: dict[str, tuple[Callable[[Path], Path], dict[int, int] | None]] = {
    "openpose": (openpose, None),
    "openpose of 18 points": (lambda folder: openpose(folder, eighteen), None),
    "coco of alphapose": (alphapose_list, NUMBERED),
    "coco": (coco, NUMBERED),
    "mmpose": (mmpose_video, NUMBERED),
    "mmpose images": (mmpose_images, NUMBERED),
    "mmpose output of a video": (in_predictions(mmpose_video), NUMBERED),
    "mmpose output of images": (in_predictions(mmpose_images), NUMBERED),
    "deeplabcut": (deeplabcut, BY_PLACE),
}


def same(frames: Pose2DFrames, tracks: dict[int, int] | None) -> None:
    assert frames.skeleton.keypoints == COCO.keypoints
    for number, people, ids in zip(NUMBERS, PEOPLE, IDS, strict=True):
        seen = frames.frame(number, 40)
        assert (seen.camera, seen.t_ns, len(seen)) == ("cam", 40, len(people))
        assert np.allclose(seen.xy_img, people[..., :2], atol=1e-3) and np.allclose(seen.score, people[..., 2], atol=1e-6)
        assert seen.track_id.tolist() == [UNTRACKED if tracks is None else tracks[i] for i in ids]
    assert len(frames.frame(99, 0)) == 0


@pytest.mark.parametrize("name", WRITERS)
def test_the_same_people_in_every_format(name: str, tmp_path: Path) -> None:
    write, tracks = WRITERS[name]
    frames = read_pose2d(write(tmp_path), "cam")
    assert frames.format == name.split()[0]
    same(frames, tracks)


def test_a_deeplabcut_file_made_by_pandas() -> None:
    frames = read_pose2d(DATA / "deeplabcut_two.csv", "cam")
    assert frames.skeleton.keypoints == ("nose", "left_shoulder", "right_shoulder", "left_knee")
    assert frames.skeleton.bones == (("left_shoulder", "right_shoulder"),)
    assert [len(frames.frame(i, 0)) for i in range(3)] == [2, 1, 2]
    assert frames.frame(0, 0).xy_img[0, 0] == pytest.approx([254.78, 107.91], abs=0.01)


def test_the_table_of_deeplabcut_is_refused_with_how_to_make_the_csv(tmp_path: Path) -> None:
    path = tmp_path / "camDLC.h5"
    path.write_bytes(b"\x89HDF\r\n\x1a\n")
    refusal(InputError, r"camDLC\.h5: camera cam: .*analyze_videos_converth5_to_csv", read_pose2d, path, "cam")


@pytest.mark.parametrize("key", ["people", "bodies"])
def test_the_other_forms_of_alphapose_are_refused_with_the_one_to_write(key: str, tmp_path: Path) -> None:
    path = save(tmp_path / "alphapose-results.json", {"0.jpg": {"version": "AlphaPose v0.3", key: []}})
    refusal(InputError, "AlphaPose in its usual form", read_pose2d, path, "cam")


@pytest.mark.parametrize(
    ("count", "name"),
    [(26, "halpe_26"), (52, "synthpose_52"), (133, "coco_wholebody_133"), (136, "halpe_136"), (33, "blazepose33")],
)
def test_larger_keypoint_sets_are_recognised_by_their_number(count: int, name: str, tmp_path: Path) -> None:
    people = [{"pose_keypoints_2d": np.ones((count, 3)).ravel().tolist()}]
    save(tmp_path / "a_0.json", {"people": people})
    assert read_pose2d(tmp_path, "cam").skeleton.name == name


def test_names_of_keypoints() -> None:
    knees = ("RKnee", "knee_r", "Right Knee", "RIGHT_KNEE", "rightKnee", "right-knee", "rightknee")
    others = {"Nose": "nose", "LBigToe": "left_big_toe", "MidHip": "mid_hip", "mouth_left": "left_mouth", "tail": "tail"}
    given = dict.fromkeys(knees, "right_knee") | others
    assert {name: keypoint_name(name) for name in given} == given


def test_what_is_no_known_format_lists_what_was_looked_for(tmp_path: Path) -> None:
    path = save(tmp_path / "odd.json", {"skeletons": []})
    message = refusal(InputError, "", read_pose2d, path, "cam")
    assert all(format.NAME in message for format in FORMATS)
    refusal(InputError, "no such file", read_pose2d, tmp_path / "absent.json", "cam")
    (tmp_path / "half.json").write_text("[{")
    refusal(InputError, "cannot be parsed as JSON", read_pose2d, tmp_path / "half.json", "cam")


def test_the_same_keypoint_under_two_names_is_an_error(tmp_path: Path) -> None:
    path = tmp_path / "x.csv"
    path.write_text("scorer,n,n,n,n\nbodyparts,LKnee,LKnee,left_knee,left_knee\ncoords,x,y,x,y\n0,1,2,3,4\n")
    refusal(InputError, "all of which mean left_knee", read_pose2d, path, "cam")


@pytest.mark.parametrize("cut", [3, 150])
def test_a_deeplabcut_file_that_was_cut_short_is_named_with_its_row(tmp_path: Path, cut: int) -> None:
    """The messages quoted an IndexError and numpy."""
    path = deeplabcut(tmp_path)
    lines = path.read_text().splitlines()
    row, lines = (2, lines[:1] + [lines[1][:cut]] + lines[2:]) if cut == 3 else (5, [*lines[:4], lines[4][:cut]])
    path.write_text("\n".join(lines))
    refusal(InputError, rf"camDLC\.csv: row {row}: expected \d+ columns, got \d+", read_pose2d, path, "cam")


def test_a_deeplabcut_table_that_a_spreadsheet_saved_has_a_mark_at_its_start(tmp_path: Path) -> None:
    """It was no known format."""
    path = deeplabcut(tmp_path)
    before = read_pose2d(path, "cam").frame(0, 0)
    path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes())
    assert np.array_equal(read_pose2d(path, "cam").frame(0, 0).xy_img, before.xy_img, equal_nan=True)


def test_a_name_of_any_length_is_one_short_line(tmp_path: Path) -> None:
    path = deeplabcut(tmp_path)
    path.write_text(path.read_text().replace("nose", "x" * 70_000, 1))
    message = refusal(InputError, "expected a column", read_pose2d, path, "cam")
    assert len(message) < 500


def test_people_of_different_sets_in_one_file_are_named(tmp_path: Path) -> None:
    rows = [{"image_id": i, "category_id": 1, "keypoints": [1.0] * 3 * count} for i, count in enumerate((17, 26))]
    with pytest.raises(InputError, match=r"entry 1: expected 17 keypoints \(coco17\), got 26"):
        read_pose2d(save(tmp_path / "a.json", rows), "cam")
