"""A live session with its host, see `session`. Arguments: ``setup``, ``networks``, ``settings`` (by dotted key)."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

import posefuse as pf
from posefuse.api.live import LiveSession
from posefuse.core import Detections2D, JointAngles, LivePreview, Pose3D, PosefuseError, Skeleton
from posefuse.core.arrays import Array
from posefuse.core.joint_angles import angle_labels
from posefuse.outputs.drawing import person_rgb
from posefuse_studio.scene_messages import image_message, page_message, poses_message, setup_message
from posefuse_studio.session import STATUS_S, CameraStatus, Host, Pace, SessionStatus
from posefuse_studio.setups import rig_of_setup, setup_named, sources_of_setup
from posefuse_studio.workspace import POSES_FILE, StudioWorkspace, check_name

IMAGES_HZ, POSES_HZ = 15.0, 40.0
_MOST_NEWS = 30
# more than the latency of a busy machine, at up to 100 poses a second
_MOST_PAST = 100
_WAIT_S = 0.1


def run(arguments: Mapping[str, Any], workspace: StudioWorkspace, progress: Any) -> dict[str, Any]:
    """Until it is cancelled or its sources end."""
    setup = setup_named(workspace, str(arguments["setup"]))
    rig = rig_of_setup(workspace, setup)
    sources = sources_of_setup(workspace, setup)
    rig = rig.only([name for name in rig.names if name in sources])
    networks = str(arguments.get("networks") or "") or None
    session = pf.live(rig, sources, networks=networks, settings=arguments.get("settings"), loop_s="shortest", progress=progress)
    shown = _Shown(session, rig, workspace, progress)
    session.on_image = shown.image
    progress("start", 0, None, "starting the cameras and the network")
    # a session has no end of its own: one that is ended has done what it was for
    with session, suppress(KeyboardInterrupt):
        shown.run()
    return {"recordings": [name for name in shown.recordings if workspace.path(name).is_file()]}


class _Shown:
    """The session as pages see it."""

    def __init__(self, session: LiveSession, rig: pf.Rig, workspace: StudioWorkspace, progress: Any) -> None:
        self._session, self._rig, self._workspace, self._progress = session, rig, workspace, progress
        self._places = {name: number for number, name in enumerate(rig.names)}
        requests: dict[str, Callable[..., None]] = {
            "output": self._switch, "record": self._record, "stop_recording": self._stop_recording,
            "person": self._choose,
        }  # fmt: skip
        self._host = Host({name: partial(self._try, do) for name, do in requests.items()}, self._watched)
        self._refused: list[str] = []
        self._person: int | None = None
        # folder of the recording that runs, and since when
        self._recording, self._since_s = "", 0.0
        self._wanted: list[str] = []
        self._begun_s = time.time()
        self._setup_of: tuple[Skeleton, tuple[str, ...]] | None = None
        self._plots: list[str] = []
        self._past: tuple[Pose3D, ...] = ()
        self.recordings: list[str] = []

    def run(self) -> None:
        """Pack and report until the session ends."""
        host = self._host
        self._progress.listens(host.address)
        pose_pace, status = Pace(1 / POSES_HZ), Pace(STATUS_S)
        t_ns = 0
        while not self._session.ended:
            self._session.wait_newer(t_ns, _WAIT_S)
            newest = self._session.newest()
            if newest is not None:
                t_ns = newest.message.pose.t_ns
                self._past = (*self._past[1 - _MOST_PAST :], newest.message.pose)
                self._set_up(newest.message.pose.skeleton, newest.message.joints)
                if host.watched and pose_pace.due():
                    self._publish(newest.message.pose, newest.message.joints)
            if status.due():
                host.status(self._status(newest.message.pose if newest else None))
            if not host.watched:
                # at the full output rate this loop alone would cost some per cent of a core
                time.sleep(_WAIT_S)

    def image(self, preview: LivePreview, view: Detections2D | None) -> None:
        """See `LiveSession.on_image`."""
        if not self._host.watched:
            return
        camera = self._rig[preview.camera]
        scale = np.divide(preview.size_wh, camera.size_wh)
        seen = None if view is None else np.where(view.score[..., None] > 0, view.xy_img, np.nan) * scale
        # the image is older than the newest pose, the more the busier the machine
        pose = nearest_pose(self._past, preview.t_ns)
        fused = None if pose is None or not len(pose.person_id) else camera.project(pose.xyz_world) * scale
        image = image_message(
            preview.t_ns / 1e9 - self._begun_s,
            self._places[preview.camera],
            preview.jpeg,
            preview.size_wh,
            detected_px=seen,
            projected_px=fused,
            rgba=[] if pose is None or fused is None else _colours(pose.person_id),
        )
        self._host.publish(f"image {preview.camera}", image)

    def _publish(self, pose: Pose3D, joints: JointAngles | None) -> None:
        t_s = pose.t_ns / 1e9 - self._begun_s
        several = len(pose.person_id) > 1
        rgba = _colours(pose.person_id) if several else None
        self._host.publish("poses", poses_message(t_s, pose.person_id, pose.xyz_world, pose.cov_world, rgba=rgba))
        if joints is not None and len(joints.person_id):
            ids = joints.person_id.tolist()
            n = ids.index(self._person) if self._person in ids else 0
            degrees = np.degrees([joints.angle_rad[0, n].ravel(), joints.sigma_rad[0, n].ravel()])
            self._host.publish("values", page_message("values", {"values": degrees.T}, t_s=t_s))

    def _set_up(self, skeleton: Skeleton, joints: JointAngles | None) -> None:
        """The scene, again whenever a camera becomes faulty or well."""
        faulty = tuple(name for name, camera in self._session.cameras.items() if camera.state != "ok")
        self._plots = self._plots if joints is None else angle_labels(joints, " ")
        if self._setup_of != (skeleton, faulty):
            self._setup_of = skeleton, faulty
            self._host.publish("setup", setup_message(self._rig, skeleton, faulty=faulty), keep=True)

    def _status(self, pose: Pose3D | None) -> SessionStatus:
        latencies = [one.figures.get("latency_p95_ms", 0.0) for one in self._session.cameras.values()]
        return SessionStatus(
            cameras={camera.name: self._camera(camera.name, camera.size_wh) for camera in self._rig},
            recording=self._recording,
            seconds=time.monotonic() - self._since_s,
            people=[] if pose is None else pose.person_id.tolist(),
            person=self._person,
            plots=self._plots,
            outputs={name: replace(one, text=self._workspace.in_names(one.text)) for name, one in self._session.outputs.items()},
            wanted=list(self._wanted),
            latency_p95_ms=max(latencies, default=0.0) or None,
            news=[*map(self._workspace.in_names, self._session.news[-_MOST_NEWS:])],
            refused=list(self._refused[-_MOST_NEWS:]),
        )

    def _camera(self, name: str, size_wh: tuple[int, int]) -> CameraStatus:
        health = self._session.cameras.get(name)
        if health is None:
            return CameraStatus(light="doubt", state="starting", size_wh=size_wh)
        latency_ms, dropped = (health.figures.get(figure, 0.0) for figure in ("latency_p95_ms", "replaced"))
        # not a number before the first frame
        figures = (f"{latency_ms:.0f} ms" if latency_ms > 0 else "–") + (f", {dropped:.0f} dropped" if dropped else "")
        good = "good" if health.state == "ok" else "bad"
        return CameraStatus(light=good, state=health.state, text=health.text, figures=figures, size_wh=size_wh)  # type: ignore[arg-type]

    def _watched(self, on: bool) -> None:
        self._session.show_images(IMAGES_HZ if on else 0.0)

    def _try(self, do: Callable[..., None], **values: Any) -> None:
        """A request; what cannot be done is shown."""
        try:
            do(**values)
            # what was refused before has been done now, or is wanted no more
            self._refused.clear()
        except (PosefuseError, OSError) as error:
            self._refused.append(f"{time.time():.0f} {self._workspace.in_names(str(error))}")

    def _switch(self, name: str, options: Mapping[str, Any] | None) -> None:
        if options is None:
            self._session.switch_off(name)
        else:
            self._session.switch_on(name, options)
        self._wanted = [one for one in self._wanted if one != name] + [name] * (options is not None)

    def _choose(self, person: int) -> None:
        self._person = int(person)

    def _record(self, name: str, poses: bool, videos: bool) -> None:
        """Into a new folder, which `posefuse track` takes as a session when it has videos."""
        if self._recording:
            return
        check_name(name)
        place = self._workspace.free_name("recordings", name)
        folder = self._workspace.folder(place)
        self._rig.save(folder / "rig.toml")
        if poses:
            self._session.switch_on("record", {"path": folder / POSES_FILE})
        if videos:
            (folder / "videos").mkdir()
            self._session.keep_videos(folder / "videos")
        self._recording, self._since_s = place, time.monotonic()
        self.recordings.append(f"{place}/{POSES_FILE}")

    def _stop_recording(self) -> None:
        self._recording = ""
        self._session.switch_off("record")
        self._session.keep_videos(None)


def nearest_pose(past: Sequence[Pose3D], t_ns: int) -> Pose3D | None:
    """The one whose time is nearest; None where there is none."""
    return min(past, key=lambda pose: abs(pose.t_ns - t_ns), default=None)


def _colours(person_id: Array) -> list[tuple[int, int, int, int]]:
    return [(*person_rgb(int(person)), 255) for person in person_id]
