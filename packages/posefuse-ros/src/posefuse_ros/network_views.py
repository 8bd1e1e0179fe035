"""Views of camera nodes on other machines, as a live session takes them, and who may send them.

Who sent first keeps a camera; the skeleton of the first view only.
"""

from __future__ import annotations

import threading
import time
from collections import Counter, deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

from posefuse.core import Closing, Detections2D, LiveJointCentres, Rig, Skeleton, SourceError
from posefuse.core.skeleton import BLAZEPOSE33
from posefuse.foundation.channel import Channel, ChannelClosed
from posefuse.health.camera_monitor import JUMP_NS, CameraState
from posefuse.realtime.config import LiveConfig
from posefuse.realtime.estimator import warmed_up
from posefuse.realtime.messages import SeenView, SessionClock, ViewSource
from posefuse.realtime.notices import Say

from . import topics
from .camera_info import NodeIntrinsics
from .camera_messages import JOINT_CENTRES_TYPE, joint_centres_from_message
from .dds import RosNode, Sample
from .dds_domain import Network
from .messages import DETECTIONS_TYPE, detections_from_message, state_from_message
from .types import Intake

_S = 1_000_000_000
_MOST_REASONS = 100


class Senders:
    """Decides on every view that comes over a network.

    Who sends a camera's views first keeps the camera, also while it pauses, until it has left the network.

    Args:
        cameras: of the rig.

    Attributes:
        skeleton: of the session, that of the first view; None until it has come.
        refused: how many messages were refused, by reason. news: reasons that were not reported yet.
        strangers: how many views of cameras came that are not in the rig, by camera.
        present: the senders on the network; None while that is not known.
    """

    def __init__(self, cameras: tuple[str, ...]) -> None:
        self.present: set[str] | None = None
        self.skeleton: Skeleton | None = None
        self.refused: Counter[str] = Counter()
        self.strangers: Counter[str] = Counter()
        self.news: list[str] = []
        self._names = cameras
        # who sends the views of each camera now
        self._cameras: dict[str, str] = {}

    def admits(self, view: Detections2D, sender: str) -> bool:
        """Whether to use a view that came from `sender`."""
        why = self._objection(view, sender)
        if why:
            self._refuse(why)
        return why is None

    def sender(self, camera: str) -> str | None:
        """Who sends the views of a camera."""
        return self._cameras.get(camera)

    def _objection(self, view: Detections2D, sender: str) -> str | None:
        """Why not to use a view: empty where that needs no word; None: it is used."""
        name = view.camera
        if name not in self._names:
            self.strangers[name if len(self.strangers) < _MOST_REASONS else "others"] += 1
            return ""
        if self.skeleton is None:
            self.skeleton = view.skeleton
        if view.skeleton != self.skeleton:
            theirs, ours = (f"{one.name} ({len(one)} keypoints)" for one in (view.skeleton, self.skeleton))
            return f"camera {name}: views have the skeleton {theirs}, this session has {ours}: not used"
        owner = self._cameras.get(name, sender)
        gone = self.present is not None and owner not in self.present
        if owner != sender and not gone:
            return f"camera {name}: views of a second sender ({sender}) are not used, the camera is that of {owner}"
        self._cameras[name] = sender
        if self.present is not None:
            self.present.add(sender)
        return None

    def _refuse(self, why: str) -> None:
        why = why if why in self.refused or len(self.refused) < _MOST_REASONS else "others"
        if why not in self.refused:
            self.news.append(why)
        self.refused[why] += 1


_WAIT_S = 0.2
_AT_ONCE = 64
# clocks of two machines that are further apart are not synchronised
CLOCKS_APART_NS = JUMP_NS // 2
_KEPT_DELAYS = 256
# of one message
_MAX_BYTES = 240_000
_MOST_NODES = 100
# who is on the network is asked this often
_PRESENT_S = 1.0
_FIRST_VIEW_S = 0.5


class ViewIntake:
    """Messages of camera nodes, and of strangers, to what the fusion takes; no network and no clock inside.

    Attributes:
        intake: counts what came and what could not be read, and why. senders: decides what is used, and counts the rest.
    """

    def __init__(self, cameras: tuple[str, ...]) -> None:
        self.intake = Intake(DETECTIONS_TYPE, lambda msg: (detections_from_message(msg), state_from_message(msg)), _MAX_BYTES)
        self.senders = Senders(cameras)
        self._centres_intake = Intake(JOINT_CENTRES_TYPE, joint_centres_from_message, _MAX_BYTES, self.intake.counts)
        # joint centres reported by the nodes, by sender
        self._centres: dict[str, LiveJointCentres] = {}
        # how long after they were sent, by the two machines' clocks, the newest views of each sender came
        self._delays_ns: dict[str, deque[int]] = {}
        # senders whose clock was reported
        self._reported: set[str] = set()

    def centres(self, sample: Sample) -> list[SeenView | LiveJointCentres]:
        """Joint centres reported by a node: used for cameras whose views it sends, kept for others."""
        if (received := self._centres_intake.take(sample.raw)) is None:
            return []
        if len(self._centres) > _MOST_NODES:
            self._centres.clear()
        self._centres[sample.sender] = received
        own = tuple(name for name in received.cameras if self.senders.sender(name) == sample.sender)
        return [replace(received, cameras=own)] if own else []

    def view(self, sample: Sample, now_ns: int) -> list[SeenView | LiveJointCentres]:
        """A view that arrived at `now_ns`; before the first view of a sender, the joint centres it reported for the camera."""
        if (taken := self.intake.take(sample.raw)) is None:
            return []
        (view, stages), state = taken
        seen = _seen(view, stages, state, sample.sent_ns, now_ns)
        camera = seen.detections.camera
        before = self.senders.sender(camera)
        if not self.senders.admits(seen.detections, sample.sender):
            return []
        if "detected" in stages:
            seen = self._by_our_clock(seen, sample.sender, now_ns)
        centres = self._centres.get(sample.sender)
        if before != sample.sender and centres is not None and camera in centres.cameras:
            return [replace(centres, cameras=(camera,)), seen]
        return [seen]

    def _by_our_clock(self, seen: SeenView, sender: str, now_ns: int) -> SeenView:
        """The view with times of this machine's clock where the sender's is far off.

        The shortest delay of its newest views is that of the clocks; what is left of it is found from the moving person.
        """
        if len(self._delays_ns) > _MOST_NODES:
            self._delays_ns.clear()
            self._reported.clear()
        delays_ns = self._delays_ns.setdefault(sender, deque(maxlen=_KEPT_DELAYS))
        delays_ns.append(now_ns - seen.detected_ns)
        behind_ns = min(delays_ns)
        if abs(behind_ns) < CLOCKS_APART_NS:
            return seen
        if sender not in self._reported:
            self._reported.add(sender)
            self.senders.news.append(
                f"camera {seen.detections.camera}: the clock of its machine is {-behind_ns / _S:+.1f} s off this one's; "
                "its views are timed by their arrival: synchronise the clocks (NTP, PTP)"
            )
        return replace(
            seen,
            detections=replace(seen.detections, t_ns=seen.detections.t_ns + behind_ns),
            received_ns=seen.received_ns + behind_ns,
            started_ns=seen.started_ns + behind_ns,
            detected_ns=seen.detected_ns + behind_ns,
        )


class NetworkViews(Closing, ViewSource):
    """Views of other machines for a session: topics are read in a thread. A context manager that closes them.

    Args:
        rig: its cameras are taken. clock: of the session.
        duration_s: no first view is waited for any longer; None: no limit.

    Attributes:
        views: what is made of the messages.
    """

    def __init__(
        self,
        rig: Rig,
        network: Network,
        clock: SessionClock,
        config: LiveConfig,
        *,
        duration_s: float | None = None,
        say: Say = lambda line: None,
    ) -> None:
        self.views = ViewIntake(rig.names)
        self._rig, self._clock, self._config, self._duration_s, self._say = rig, clock, config, duration_s, say
        self._begun_ns = clock.now_ns()
        self._node = RosNode("posefuse_fusion_intake", network)
        self._reader = self._node.reader(topics.DETECTIONS)
        self._centres_reader = self._node.reader(topics.JOINT_CENTRES)
        self._intrinsics = NodeIntrinsics(self._node, rig)
        self._ours, self._theirs = Channel.pair()
        # the first of each kind, of the network; empty once reported
        self._problems: dict[str, str] = {}
        self._stop = threading.Event()
        self._chosen = threading.Event()
        self._thread = threading.Thread(target=self._run, name="views from the network", daemon=True)
        self._thread.start()

    def channels(self) -> list[Channel]:
        """For `select`."""
        return [self._ours]

    def messages(self) -> Iterator[SeenView | LiveJointCentres]:
        """What has come; never waits."""
        for _ in range(_AT_ONCE):
            received = self._ours.receive()
            if received is None:
                return
            yield received

    def notices(self) -> list[str]:
        """Why messages are refused, each reason once; and camera nodes that work with other intrinsics."""
        senders, intrinsics = self.views.senders, self._intrinsics
        new = {kind: problem for kind, problem in tuple(self._problems.items()) if problem}
        self._problems |= dict.fromkeys(new, "")
        found, senders.news, intrinsics.problems = [*senders.news, *intrinsics.problems, *new.values()], [], []
        return found

    def wait_ready(self, stopped: Sequence[str]) -> Skeleton:
        """The skeleton of the first view."""
        # compiled for any skeleton, before a view is there to be waited for
        warmed_up(self._rig, BLAZEPOSE33, self._config, stopped)
        while not self._chosen.wait(_FIRST_VIEW_S):
            if stopped or (self._duration_s is not None and self._waited_s() >= self._duration_s):
                raise SourceError(self._nothing_came())
        self._say(f"first view after {self._waited_s():.1f} s")
        assert self.views.senders.skeleton is not None
        return self.views.senders.skeleton

    def start(self, clock: SessionClock) -> int:
        """They come already; the session counts from when it began to wait for them."""
        return self._begun_ns

    def close(self) -> None:
        """Leave the network."""
        self._stop.set()
        self._thread.join(2 * _WAIT_S)
        self._node.close()
        self._ours.close()
        self._theirs.close()

    def _run(self) -> None:
        asked_s = -_PRESENT_S
        while not self._stop.is_set():
            now_s = time.monotonic()
            try:
                if now_s - asked_s > _PRESENT_S:
                    asked_s, self.views.senders.present = now_s, self._reader.senders()
                if self._node.wait(_WAIT_S):
                    self._hand_on()
            except ChannelClosed:
                return
            except Exception as error:  # noqa: BLE001 - reported; without this thread no view would come any more
                kind = type(error).__name__
                self._problems.setdefault(kind, f"the network cannot be read ({kind}: {error})")
                self._stop.wait(_WAIT_S)

    def _hand_on(self) -> None:
        self._intrinsics.receive()
        for sample in self._centres_reader.take():
            for found in self.views.centres(sample):
                self._theirs.send(found, _WAIT_S)
        for sample in self._reader.take():
            for found in self.views.view(sample, self._clock.now_ns()):
                self._theirs.send(found)
        if self.views.senders.skeleton is not None:
            self._chosen.set()

    def _waited_s(self) -> float:
        return (self._clock.now_ns() - self._begun_ns) / _S

    def _nothing_came(self) -> str:
        counts, strangers = self.views.intake.counts, self.views.senders.strangers
        why = f"; {counts.refused} messages were refused, the last because: {counts.last_refusal}" if counts.refused else ""
        others = f"; there are views of {', '.join(sorted(strangers))}, not in the rig" if strangers else ""
        return f"no view of any camera of the rig came{why}{others}; are the camera nodes in the same domain?"


def _seen(view: Detections2D, stages: Mapping[str, int], state: CameraState | None, sent_ns: int, now_ns: int) -> SeenView:
    received_ns = stages.get("received", min(sent_ns, now_ns))
    started_ns = stages.get("started", received_ns)
    return SeenView(
        detections=view,
        state=state,
        received_ns=received_ns,
        started_ns=started_ns,
        detected_ns=stages.get("detected", started_ns),
    )
