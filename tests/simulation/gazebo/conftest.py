"""One small world with everything in it, and other people's readers of it; skipped by name where they are not installed."""

import json
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path

import pytest
import scenes

import posefuse as pf
from posefuse_sim import Scene
from posefuse_sim.build import LiveScene, live_scene
from posefuse_sim.gazebo import GazeboWorld
from posefuse_sim.gazebo.export import shown_scene
from posefuse_sim.scene import scene_text

_HERE = Path(__file__).parent
# every axis of the image and both focal lengths differ, so that nothing can be taken for another
_PLAIN = {"size_px": [320, 200], "K": [[260.0, 0, 148.25], [0, 290.0, 111.75], [0, 0, 1]]}
_BENT = {"size_px": [240, 180], "horizontal_fov_deg": 70, "distortion": [-0.25, 0.08, 0.002, -0.001, 0.0]}
_SENSOR = {"rate_hz": 12.5, "noise_dn": 2.0, "offset_s": 0.5, "exposure_s": 0.004}

SCENE = scenes.scene(
    rate_hz=20,
    seed=3,
    cameras=scenes.listed(
        {"name": "plain", "position_m": [3.4, 0.6, 1.9], "roll_deg": 12, "image": _PLAIN},
        {"name": "bent", "position_m": [-1.8, -2.6, 1.4], "image": _BENT, "sensor": _SENSOR},
        {"name": "above", "position_m": [0.2, 0.1, 3.4], "look_at_m": [0.2, 0.1, 0.0], "image": _PLAIN},
    ),
    people=[{"motion": {"kind": "walk", "speed_mps": 1.3, "path": {"shape": "circle", "radius_m": 1.2}}}],
    occluders=[{"kind": "box", "position_m": [0.9, -0.9, 0.3], "size_m": [0.3, 0.4, 0.6], "yaw_deg": 25}],
    props=[{"kind": "charuco_board", "name": "board", "path": scenes.still([-1, 1, 1], roll_deg=80, yaw_deg=30)}],
    room={"size_m": [8.0, 9.0]},
)


@dataclass(frozen=True)
class Written:
    """A world on disk, and the scene it shows."""

    world: GazeboWorld
    live: LiveScene

    @property
    def sdf(self) -> Path:
        return self.world.folder / "world.sdf"


@pytest.fixture(scope="session")
def scene() -> Scene:
    return SCENE


@pytest.fixture(scope="session")
def written(tmp_path_factory) -> Written:
    folder = tmp_path_factory.mktemp("gazebo")
    (folder / "scene.yaml").write_text(scene_text(SCENE))
    world = pf.gazebo_world(folder / "scene.yaml", folder / "world")
    return Written(world, live_scene(shown_scene(SCENE)))


def _compiled(name: str, package: str, debian: str, folder: Path) -> Path:
    """A small C++ program of this folder, built against a Debian library."""
    if shutil.which("g++") is None or shutil.which("pkg-config") is None:
        pytest.skip("g++ or pkg-config is not installed")
    flags = subprocess.run(["pkg-config", "--cflags", "--libs", package], capture_output=True, text=True, check=False, timeout=60)
    if flags.returncode:
        pytest.skip(f"{package} is not installed (Debian: {debian})")
    program = folder / name
    source = _HERE / f"{name}.cc"
    subprocess.run(["g++", "-std=c++17", "-w", str(source), "-o", str(program), *flags.stdout.split()], check=True, timeout=300)
    return program


@pytest.fixture(scope="session")
def libsdformat(tmp_path_factory):
    """What libsdformat reads from a world file: a dict, or None where it reports an error or what SDF does not have."""
    program = _compiled("sdf_world", "sdformat12", "libsdformat-dev", tmp_path_factory.mktemp("cc"))

    def read(world: Path):
        done = subprocess.run([str(program), str(world)], capture_output=True, text=True, check=False, timeout=120)
        return json.loads(done.stdout) if done.returncode == 0 else None

    return read


@pytest.fixture(scope="session")
def gazebo_reader(tmp_path_factory):
    """What Gazebo's COLLADA reader makes of an actor's file: facts, poses of the joints by name and time, places of the skin."""
    program = _compiled("dae_actor", "ignition-common4-graphics", "libignition-common-dev", tmp_path_factory.mktemp("cc"))

    def read(file: Path, times_s):
        command = [str(program), str(file), *(f"{t:.9f}" for t in times_s)]
        done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)
        assert done.returncode == 0, f"{done.returncode} {done.stderr}"
        facts, *poses, skin = map(json.loads, done.stdout.splitlines())
        return facts, poses, skin

    return read
