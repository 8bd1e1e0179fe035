"""What is decided about a Gazebo world in addition to its scene, and what of a scene Gazebo can show."""

from __future__ import annotations

from dataclasses import dataclass, replace

from posefuse.core import ConfigError
from posefuse.simulation.cameras import ListedCameras, PlacedCamera, SensorSettings, placed_cameras
from posefuse.simulation.scene import Scene


@dataclass(frozen=True, kw_only=True)
class GazeboSettings:
    """How a scene becomes a Gazebo world.

    Attributes:
        release: ``fortress``, ``harmonic`` or ``jetty``: the names of plug-ins differ.
        step_s: simulation time passes in such steps; images are stamped with multiples of it.
        truth_hz: at least so many time steps per second of truth; linear interpolation between them is then within 0.1 mm for
            an acceleration of 50 m/s^2.
        most_between_keys_m: how far the animation may be from the true motion between its keys.
        most_animation_s: longest animation that is baked: one minute of a walk takes about 30 MB.
    """

    release: str = "harmonic"
    step_s: float = 0.001
    truth_hz: float = 240.0
    most_between_keys_m: float = 0.0005
    most_animation_s: float = 600.0


def shown_scene(scene: Scene, settings: GazeboSettings) -> tuple[Scene, list[str]]:
    """The scene as Gazebo shows it, its time beginning at 0, and what had to be left out, in words.

    Raises:
        ConfigError: it lasts too long, or less than a millisecond.
    """
    duration_s = int(scene.duration_s * 1000 + 1e-6) / 1000
    if not 0 < duration_s <= settings.most_animation_s:
        raise ConfigError(
            f"duration_s: expected 0.001 to {settings.most_animation_s:g} s for Gazebo, got {scene.duration_s:g} s; "
            "the animation begins again at its end, so a shorter scene continues as well"
        )
    cameras, left_out = [], []
    for camera in placed_cameras(scene.cameras):
        rate_hz = camera.sensor.rate_hz or scene.rate_hz
        kept = SensorSettings(rate_hz=rate_hz, noise_dn=camera.sensor.noise_dn)
        names = _set(replace(camera.sensor, rate_hz=rate_hz), kept)
        if names:
            left_out.append(f"{camera.name}: {', '.join(names)}: Gazebo's cameras have no such thing; left out")
        cameras.append(_with_sensor(camera, kept))
    if scene.start_s:
        left_out.append(f"start_s: simulation time begins at 0, not at {scene.start_s:g} s")
    listed = ListedCameras(kind="list", cameras=tuple(cameras))
    return replace(scene, cameras=listed, duration_s=duration_s, start_s=0.0), left_out


def _with_sensor(camera: PlacedCamera, sensor: SensorSettings) -> PlacedCamera:
    return replace(camera, sensor=sensor)


def _set(sensor: SensorSettings, kept: SensorSettings) -> list[str]:
    """Names of the settings that are lost from `sensor` to `kept`; how finely a shutter is drawn is none by itself."""
    silent = ("shutter_bands", "blur_samples")
    return [name for name, value in vars(sensor).items() if name not in silent and value != getattr(kept, name)]
