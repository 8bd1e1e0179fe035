"""Camera health: which camera is faulty, and the kind of fault, from the content and arrival times of its frames.

No clock inside: times come as data. A camera that moved is found by what it sees of people: `health.rig_monitor`.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from statistics import median

from posefuse.core import CameraHealth, Detections2D

OK = "ok"
_S = 1_000_000_000
# a camera whose image stays identical this long is frozen
FROZEN_NS = _S // 2
# the time stamp of a frame is wrong when the frame's age differs from the usual one by this much
JUMP_NS = _S // 2
_AGREE_NS = _S // 10
_AGREEING = 8
# frames older than usual by less than this may just be late (a slow stream or processor): more of them must agree before
# the clock is blamed. A frame that is older than the one before it is not late: its clock was set back
_LATE_NS = 3 * _S
_AGREEING_LATE = 90
_USUAL_OF = 31
_AGE_UNTIL_KNOWN_NS = 40_000_000
SILENT_NS = _S
# cameras needed for a pose
_ENOUGH = 2
# the machine is overloaded when a smaller share of a camera's frames is used over this time: too few to judge the rig
_OVERLOAD_SHARE, _SHARE_NS = 0.7, 2 * _S
# the most frames per second that one camera may deliver. More are named here, and left out where frames wait (the newest is used)
# and by the tracker
FLOOD_HZ = 250
_COUNT_NS = _S // 5


@dataclass(frozen=True, kw_only=True)
class CameraState:
    """Status of one camera in its group.

    Attributes:
        state: ``opening``, ``running``, ``ended`` (source is over) or ``lost`` (tries again).
        text: why, when not running.
        captured: frames that reached the process. used: processed by the detector. replaced: dropped for a newer one.
        missing: frames the camera counted but never delivered.
    """

    camera: str
    state: str = "opening"
    text: str = ""
    captured: int = 0
    used: int = 0
    replaced: int = 0
    missing: int = 0


@dataclass(frozen=True)
class Event:
    """The state of a camera or an output has changed. `t_ns`: session time. `name`: of the camera or output."""

    t_ns: int
    name: str
    state: str
    text: str


@dataclass
class _Watch:
    """What is remembered of one camera."""

    source: CameraState
    ages_ns: deque[int] = field(default_factory=lambda: deque(maxlen=_USUAL_OF))
    strange_ns: deque[int] = field(default_factory=lambda: deque(maxlen=_AGREEING_LATE))
    shift_ns: int = 0
    newest_ns: int = -(10**18)
    set_back: bool = False
    jumped: str = ""
    late: bool = False
    jumped_at_ns: int = -(10**18)
    changed_ns: int | None = None
    frozen: bool = False
    seen_ns: int | None = None
    came_ns: int = -(10**18)
    reported_ns: int | None = None
    flooding_ns: int = -(10**18)
    flood_hz: float = 0.0
    before: tuple[int, int, int, int] = (0, 0, 0, 0)
    counted_ns: int = 0
    counted: int = 0
    share_of: tuple[int, int, int] = (0, 0, 0)
    used_share: float = 1.0
    refused: dict[str, int] = field(default_factory=dict)


class Monitor:
    """Judges every frame before it is used, and every camera once in a while.

    Attributes:
        events: what changed, oldest first, at most the newest 1000. event_count: of all there ever were.
    """

    def __init__(self, cameras: Iterable[str]) -> None:
        self._watches = {name: _Watch(CameraState(camera=name)) for name in cameras}
        self._verdicts = {name: CameraHealth("opening") for name in self._watches}
        self.events: deque[Event] = deque(maxlen=1000)
        self.event_count = 0

    def admit(self, view: Detections2D, now_ns: int, *, received_ns: int, still: int) -> Detections2D | None:
        """The view to use, its time put right where its clock has jumped; None when it must not be used.

        Args:
            view: the people in a frame; its t_ns is mid-exposure. received_ns: when the frame reached its process.
            still: how many frames in a row, this one included, were the same image.
        """
        watch = self._watches.get(view.camera)
        if watch is None:
            return None
        watch.seen_ns = now_ns
        right_ns = self._timed(watch, view.t_ns, received_ns, now_ns)
        if right_ns is None:
            _count(watch, "late" if watch.late else "clock")
            return None
        if self._is_frozen(watch, still, right_ns):
            _count(watch, "frozen")
            return None
        return view if right_ns == view.t_ns else replace(view, t_ns=right_ns)

    def take_state(self, state: CameraState, now_ns: int, *, regular: bool = False) -> None:
        """Take the status that the camera's own process reports; `regular`: it does so whether there are frames or not."""
        watch = self._watches.get(state.camera)
        if watch is None:
            return
        if regular:
            watch.reported_ns = now_ns
        if now_ns - watch.counted_ns >= _COUNT_NS:
            rate_hz = (state.captured - watch.counted) * _S / (now_ns - watch.counted_ns)
            if rate_hz > FLOOD_HZ:
                watch.flooding_ns, watch.flood_hz = now_ns, rate_hz
            watch.counted_ns, watch.counted = now_ns, state.captured
        since_ns, captured, used = watch.share_of
        if now_ns - since_ns >= _SHARE_NS:
            came = state.captured - captured
            watch.used_share = (state.used - used) / came if came > 0 and since_ns else 1.0
            watch.share_of = now_ns, state.captured, state.used
        last = watch.source
        if state.captured > last.captured:
            watch.came_ns = now_ns
        if state.captured < last.captured:
            # its process was started again and counts from 0
            captured, used, replaced, missing = watch.before
            watch.before = captured + last.captured, used + last.used, replaced + last.replaced, missing + last.missing
        watch.source = state

    def judge(
        self, now_ns: int, troubles: Mapping[str, CameraHealth], faulty: Mapping[str, CameraHealth] | None = None
    ) -> Mapping[str, CameraHealth]:
        """Every camera's state; by camera, `troubles` are those of its process, `faulty` those of its pose and clock."""
        for name, watch in self._watches.items():
            verdict = self._verdict(watch, now_ns, troubles.get(name), (faulty or {}).get(name, CameraHealth(OK)))
            if verdict.state != self._verdicts[name].state:
                self.events.append(Event(now_ns, name, verdict.state, verdict.text))
                self.event_count += 1
            self._verdicts[name] = verdict
        return dict(self._verdicts)

    def overloaded(self, camera: str) -> bool:
        """Whether too few of its frames are used to judge its pose and clock."""
        return self._watches[camera].used_share < _OVERLOAD_SHARE

    def does_without(self, camera: str) -> bool:
        """Whether enough other cameras are healthy to leave this one's views out; counts one more refused view."""
        enough = sum(verdict.state == OK for name, verdict in self._verdicts.items() if name != camera) >= _ENOUGH
        if enough:
            _count(self._watches[camera], self._verdicts[camera].state)
        return enough

    def refused(self, camera: str) -> Mapping[str, int]:
        """Views not used, by reason."""
        return dict(self._watches[camera].refused)

    def source(self, camera: str) -> CameraState:
        """The newest status of the camera's process, with counts over all processes it has had."""
        watch = self._watches[camera]
        captured, used, replaced, missing = watch.before
        return replace(
            watch.source,
            captured=watch.source.captured + captured,
            used=watch.source.used + used,
            replaced=watch.source.replaced + replaced,
            missing=watch.source.missing + missing,
        )

    def all_ended(self) -> bool:
        """Every source is over and will not come back."""
        return all(watch.source.state == "ended" for watch in self._watches.values())

    def _verdict(self, watch: _Watch, now_ns: int, trouble: CameraHealth | None, otherwise: CameraHealth) -> CameraHealth:
        if trouble is not None:
            return trouble
        if watch.source.state in ("ended", "lost"):
            return CameraHealth(watch.source.state, watch.source.text)
        if now_ns - watch.flooding_ns < _S:
            return CameraHealth("flood", f"{watch.flood_hz:,.0f} frames/s; only the newest are used")
        if now_ns - watch.jumped_at_ns < _S or watch.strange_ns:
            return CameraHealth("late" if watch.late else "clock", watch.jumped or "its time stamps jumped")
        if watch.frozen:
            return CameraHealth("frozen", "delivers the same image again and again")
        if watch.seen_ns is None:
            return CameraHealth("opening", "no frame yet")
        if now_ns - watch.seen_ns > SILENT_NS and now_ns - watch.came_ns <= SILENT_NS:
            return CameraHealth("overload", f"its frames wait: none was processed for {(now_ns - watch.seen_ns) / _S:.1f} s")
        # a process that owes a report is judged itself, soon after
        owes = watch.reported_ns is not None and now_ns - watch.reported_ns > SILENT_NS // 2
        if now_ns - watch.seen_ns > SILENT_NS * (1 + owes):
            return CameraHealth("silent", f"no frame for {(now_ns - watch.seen_ns) / _S:.1f} s")
        if otherwise.state != OK and watch.used_share < _OVERLOAD_SHARE:
            return CameraHealth("overload", f"only {watch.used_share:.0%} of its frames are used: too few to watch the rig")
        return otherwise

    def _timed(self, watch: _Watch, stamp_ns: int, received_ns: int, now_ns: int) -> int | None:
        """Mid-exposure by a clock that agrees with arrival; None until enough frames agree."""
        t_ns = stamp_ns + watch.shift_ns
        age_ns = received_ns - t_ns
        usual_ns = int(median(watch.ages_ns)) if watch.ages_ns else _AGE_UNTIL_KNOWN_NS
        if abs(age_ns - usual_ns) <= JUMP_NS:
            watch.ages_ns.append(age_ns)
            watch.strange_ns.clear()
            watch.newest_ns = t_ns
            return t_ns
        if not watch.strange_ns:
            watch.set_back = t_ns < watch.newest_ns
        watch.strange_ns.append(age_ns)
        watch.late = 0 < age_ns - usual_ns < _LATE_NS and not watch.set_back
        needed = _AGREEING_LATE if watch.late else _AGREEING
        recent = list(watch.strange_ns)[-needed:]
        jump_ns = int(median(recent)) - usual_ns
        watch.jumped_at_ns = now_ns
        agreed = len(recent) == needed and max(recent) - min(recent) <= _AGREE_NS
        watch.late = watch.late and not agreed
        watch.jumped = (
            f"frames come {jump_ns / _S:.1f} s later than usual; they are not used"
            if watch.late
            else f"its clock is {-(jump_ns + watch.shift_ns) / _S:+.1f} s off; frames are timed by their arrival"
        )
        if not agreed:
            return None
        watch.shift_ns += jump_ns
        watch.strange_ns.clear()
        return t_ns + jump_ns

    def _is_frozen(self, watch: _Watch, still: int, t_ns: int) -> bool:
        if still == 0 or watch.changed_ns is None:
            watch.changed_ns = t_ns
        watch.frozen = t_ns - watch.changed_ns >= FROZEN_NS
        # if all cameras are frozen, the scene is static and free of noise
        others = [other for other in self._watches.values() if other is not watch and other.seen_ns is not None]
        return watch.frozen and (not others or any(not other.frozen for other in others))


def _count(watch: _Watch, why: str) -> None:
    watch.refused[why] = watch.refused.get(why, 0) + 1
