"""What the whole-body fit does to joint positions, and what it could do if it knew how long the segments are.

    python bench/body_fit.py SESSION ...

Sessions are rendered, with truth. Prints the mean over 14 joints and the worst joint, mm: as tracked; fitted to the 3D points
and to the rays of all views, with the segment lengths of the recording and with the true ones.
"""

import argparse
import subprocess
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from posefuse.core import PoseSequence, Recording, Truth
from posefuse.core.joint_centres import SEGMENT_ENDS
from posefuse.evaluation.biomechanics import rays_at_joint_centres
from posefuse.evaluation.metrics import joint_errors
from posefuse.formats.recording import read_recording
from posefuse.formats.truth import read_truth
from posefuse.kinematics.body import BodyModel, bodies_from_poses, fit_poses, fit_views
from posefuse.tracking.segments import segment_lengths

# the last word of a node's offset -> the segment it is as long as; half of those that lie across the body
ALONG = {"elbow": "upper_arm", "wrist": "forearm", "knee": "thigh", "ankle": "shank", "neck": "trunk"}
ACROSS = {"shoulder": "shoulders", "hip": "hips"}


def tracked(session: Path, folder: Path) -> Recording:
    """What `posefuse track` gives."""
    command = [sys.executable, "-m", "posefuse.cli.main", "track", str(session), "--out", str(folder / "result"), "--outputs", ""]
    subprocess.run(command, check=True, capture_output=True)
    return read_recording(folder / "result")


def with_lengths(body: BodyModel, metres: dict[str, float]) -> BodyModel:
    """The same skeleton with segments of these lengths."""
    offset = body.offset.copy()
    for i, node in enumerate(body.nodes):
        end = node.offset.rpartition("_")[2]
        length = metres[ALONG[end]] if end in ALONG else metres[ACROSS[end]] / 2 if end in ACROSS else None
        if length is not None:
            offset[i] *= length / np.linalg.norm(offset[i])
    return replace(body, offset=offset)


def fits(recording: Recording, truth: Truth) -> dict[str, PoseSequence]:
    """Of one person, by name."""
    poses, rays = recording.poses, rays_at_joint_centres(recording)
    own = bodies_from_poses(poses)
    metres = dict(zip(SEGMENT_ENDS, segment_lengths(truth.xyz_world, truth.skeleton)[0], strict=True))
    true = {person: with_lengths(body, metres) for person, body in own.items()}
    return {
        "as tracked": poses,
        "points": fit_poses(poses, bodies=own).poses,
        "points, true lengths": fit_poses(poses, bodies=true).poses,
        "rays": fit_views(recording.poses, recording.rig, rays, bodies=own).poses,
        "rays, true lengths": fit_views(recording.poses, recording.rig, rays, bodies=true).poses,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("session", type=Path, nargs="+")
    for session in parser.parse_args().session:
        truth = read_truth(session / "truth" / "truth.npz")
        with tempfile.TemporaryDirectory() as folder:
            found = fits(tracked(session, Path(folder)), truth)
        print(session.name)
        for name, poses in found.items():
            errors = joint_errors(poses, truth)
            print(f"  {name:22s} {errors.mpjpe_mm:5.1f}  worst {errors.mean_mm.max():5.1f}", flush=True)


if __name__ == "__main__":
    main()
