"""Next to a marker system: aligned in time, then joint by joint.

The "marker system" here is the exact truth of the bundled clip, written as a TRC file that starts a third of a second late. Any
TRC, C3D or CSV file works. Both systems share a world frame here; with `align_space` (the default) turn and shift are
found too. Beware of people who walk in circles: a turn and whole gait cycles of delay look alike then.
"""

from pathlib import Path

import numpy as np

import posefuse as pf
from posefuse.core.skeleton import PAPER14, pick_keypoints
from posefuse.formats.trc import TrcData, write_trc
from posefuse.formats.truth import read_truth


def marker_file(session: Path, path: Path) -> Path:
    """The truth as a laboratory has it, started a third of a second late."""
    truth = read_truth(session / "truth" / "truth.npz")
    xyz = pick_keypoints(truth.xyz_world[:, 0], truth.skeleton, PAPER14.keypoints)
    time_s = (truth.t_ns - truth.t_ns[0]) * 1e-9
    late = (time_s >= 0.333) & (time_s <= 5.0)
    t_s = (truth.t_ns[late] - truth.t_ns[late][0]) * 1e-9
    write_trc(path, TrcData(names=PAPER14.keypoints, t_s=t_s, xyz_world=xyz[late], rate_hz=1 / float(np.median(np.diff(t_s)))))
    return path


def main(session: Path, out: Path) -> float:
    recording = pf.track(session, end_s=5.0)
    found = pf.compare(marker_file(session, out / "markers.trc"), recording, align_space=False)
    print(f"started {found.alignment.offset_s * 1000:+.0f} ms apart; mean distance {found.errors.mpjpe_mm:.1f} mm")
    for point, mean, sd in zip(found.points, found.errors.mean_mm, found.errors.sd_mm, strict=True):
        print(f"  {point:16s} {mean:5.1f} mm  (sd {sd:.1f})")
    return found.errors.mpjpe_mm


if __name__ == "__main__":
    folder = Path("out/gallery")
    folder.mkdir(parents=True, exist_ok=True)
    main(Path("examples/demo"), folder)
