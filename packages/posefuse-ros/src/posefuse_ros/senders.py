"""Who may send the views of which camera: who sent first, the session's skeleton only, and no floods. No clock inside."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

from posefuse.core import Detections2D, Skeleton

_S = 1_000_000_000
# a stamp within this of the arrival is that of a clock that a person has set
_BELIEVABLE_NS = 10 * _S
# a sender of which so many messages were refused in a second, and none accepted, is not read for a second
_FLOOD = 200
_VOTE_NS = _S // 2
_MOST_REASONS = 100


@dataclass
class _Camera:
    """Who sends a camera's views now, and when the newest came."""

    sender: str
    received_ns: int
    believable: bool


@dataclass
class _Sender:
    """What became of a sender's messages within the current second."""

    since_ns: int
    refused: int = 0
    accepted: int = 0


class Senders:
    """Decides on every view that comes over a network.

    Who sends a camera's views first keeps the camera, also while it pauses, until it has left the network.

    Args:
        cameras: of the rig. hand_over_s: a sender that is silent for so long makes room for another; None: never.

    Attributes:
        skeleton: of the session; None until enough views have come.
        refused: how many messages were refused, by reason. news: reasons that were not reported yet.
        strangers: how many views of cameras came that are not in the rig, by camera.
        present: the senders on the network; None while that is not known.
    """

    def __init__(self, cameras: tuple[str, ...], hand_over_s: float | None = None) -> None:
        self.present: set[str] | None = None
        self._hand_over_s = hand_over_s
        self.skeleton: Skeleton | None = None
        self.refused: Counter[str] = Counter()
        self.strangers: Counter[str] = Counter()
        self.news: list[str] = []
        self._names = cameras
        self._cameras: dict[str, _Camera] = {}
        self._senders: dict[str, _Sender] = {}
        self._votes: dict[Skeleton, set[str]] = {}
        self._vote_ns: int | None = None

    def read(self, sender: str, now_ns: int) -> bool:
        """Whether to read the next message of `sender` at all; False while it floods."""
        one = self._senders.get(sender)
        if one is None or now_ns - one.since_ns > _S:
            if len(self._senders) > _MOST_REASONS:
                self._senders.clear()
            one = self._senders[sender] = _Sender(now_ns)
        if one.accepted or one.refused < _FLOOD:
            return True
        self._refuse("a sender of nothing but refused messages floods the network: it is not read")
        return False

    def count_refused(self, sender: str) -> None:
        """A message of `sender` could not be read."""
        if sender in self._senders:
            self._senders[sender].refused += 1

    def admits(self, view: Detections2D, sender: str, now_ns: int) -> bool:
        """Whether to use a view that came from `sender`."""
        why = self._objection(view, sender, now_ns)
        if why is not None:
            self.count_refused(sender)
            if why:
                self._refuse(why)
            return False
        if sender in self._senders:
            self._senders[sender].accepted += 1
        return True

    def sender(self, camera: str) -> str | None:
        """Who sends the views of a camera."""
        one = self._cameras.get(camera)
        return one.sender if one is not None else None

    def _objection(self, view: Detections2D, sender: str, now_ns: int) -> str | None:
        """Why not to use a view: empty where that needs no word; None: it is used."""
        name = view.camera
        if name not in self._names:
            self.strangers[name if len(self.strangers) < _MOST_REASONS else "others"] += 1
            return ""
        if self.skeleton is None:
            self._vote(view, now_ns)
            return ""
        if view.skeleton != self.skeleton:
            theirs, ours = (f"{one.name} ({len(one)} keypoints)" for one in (view.skeleton, self.skeleton))
            return f"camera {name}: views have the skeleton {theirs}, this session has {ours}: not used"
        believable = abs(view.t_ns - now_ns) < _BELIEVABLE_NS
        now = self._cameras.get(name)
        taken = now is not None and now.sender != sender and not self._is_free(now, now_ns)
        if taken and now is not None and (now.believable or not believable):
            return f"camera {name}: views of a second sender ({sender}) are not used, the camera is that of {now.sender}"
        self._cameras[name] = _Camera(sender, now_ns, believable)
        if self.present is not None:
            self.present.add(sender)
        return None

    def _is_free(self, camera: _Camera, now_ns: int) -> bool:
        """Whether its sender is gone, or silent for so long that it makes room."""
        if self.present is not None and camera.sender not in self.present:
            return True
        return self._hand_over_s is not None and now_ns - camera.received_ns > self._hand_over_s * _S

    def _vote(self, view: Detections2D, now_ns: int) -> None:
        """The skeleton of most cameras becomes the session's: when half of them have sent, or half a second after the first."""
        self._vote_ns = now_ns if self._vote_ns is None else self._vote_ns
        if len(self._votes) < _MOST_REASONS:
            self._votes.setdefault(view.skeleton, set()).add(view.camera)
        leading = max(self._votes, key=lambda skeleton: len(self._votes[skeleton]))
        if 2 * len(self._votes[leading]) > len(self._names) or now_ns - self._vote_ns > _VOTE_NS:
            self.skeleton = leading

    def _refuse(self, why: str) -> None:
        why = why if why in self.refused or len(self.refused) < _MOST_REASONS else "others"
        if why not in self.refused:
            self.news.append(why)
        self.refused[why] += 1
