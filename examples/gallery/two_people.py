"""Two people who walk around each other: which person is which, and how close do they come?

The scene is simulated, so it needs the extra ``sim``: four cameras, two people on circles in opposite directions. Both keep
their id through the whole recording although they hide each other again and again.
"""

import tempfile
from pathlib import Path

import numpy as np
from matplotlib import pyplot

import posefuse as pf

SCENE = """
duration_s: {seconds}
rate_hz: 30
seed: 3
cameras: {{kind: ring, count: 4, radius_m: 4.5, height_m: 2.3, image: {{size_px: [480, 360], horizontal_fov_deg: 66}}}}
people:
  - motion: {{kind: walk, speed_mps: 1.2, path: {{shape: circle, radius_m: 1.4}}}}
  - body: {{sex: female, height_m: 1.66}}
    motion: {{kind: walk, speed_mps: 1.0, path: {{shape: circle, radius_m: 0.8, clockwise: true, start_deg: 120}}}}
"""


def main(out: Path, seconds: float = 8.0) -> tuple[int, float]:
    with tempfile.TemporaryDirectory() as folder:
        scene = Path(folder) / "two_people.yaml"
        scene.write_text(SCENE.format(seconds=seconds), encoding="utf-8")
        recording = pf.track(pf.simulate(scene, Path(folder) / "session"), people=2)
    print(recording)

    hips = recording.poses.skeleton.keypoints.index("left_hip")
    path_m = recording.poses.xyz_world[:, :, hips, :2]
    apart_m = np.linalg.norm(path_m[:, 0] - path_m[:, 1], axis=-1)
    print(f"closest: {np.nanmin(apart_m):.2f} m, after {recording.t_s[np.nanargmin(apart_m)]:.1f} s")

    figure, axes = pyplot.subplots(figsize=(4.5, 4.5), layout="constrained")
    for person, name in enumerate(recording.poses.person_id):
        axes.plot(*path_m[:, person].T, label=f"person {name}")
    axes.set(title="paths of two people from above", xlabel="x (m)", ylabel="y (m)", aspect="equal")
    axes.legend()
    figure.savefig(out / "two_people.png")
    seen = np.isfinite(path_m).all(axis=-1).mean(axis=0)
    return len(recording.poses.person_id), float(seen.min())


if __name__ == "__main__":
    target = Path("out/gallery")
    target.mkdir(parents=True, exist_ok=True)
    main(target)
