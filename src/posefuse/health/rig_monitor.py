"""Watch a rig while it is used: a moved camera, a swapped cable or a lost synchronisation shows in its residuals.

A pure function of an explicit state: `observe` takes what fusion has just used and returns the next state and what it
found. A 2D network errs by many px, and in a keypoint of a view for seconds, but differently for every keypoint, so single
residuals prove little. The test is how much of the residuals of some seconds the rotation or delay of one camera explains
(`misalignment`), compared with what keypoints explain that are asked one by one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from posefuse.calibration.verify import pairs_in_words, swapped_cameras
from posefuse.core import Rig
from posefuse.core.arrays import Array, known_median

from .misalignment import LATE, TURN, UNKNOWNS, Sums, TriangulatedStep, instant_of, sums_of

MOVED, UNSYNCHRONISED, SWAPPED = "moved", "unsynchronised", "swapped"
# time constants of the two windows: short for gross errors, long for small ones
MEMORIES_S = (2.0, 8.0)
# how many times the variance per degree of freedom a camera's rotation or delay has to explain. Rotations of healthy rigs reach
# 28 in 30 s, whatever the size of a network's errors and however long they last
_SURE = 30.0
# smallest displacement reported, and that of a rotation while a person moves less than the third value, rms: from one side all
# keypoints may be off alike (without it, a moved camera in 18 of 40 good sessions of real footage)
_LEAST_M, _STANDING_M, _STANDS_M = 0.02, 0.1, 0.3
# share of the mean information by which that of a single keypoint is raised, so that it can be inverted
_DETERMINED = 0.01
# hysteresis: a finding is cleared when the displacement falls below this share of its peak
_LEFT = 0.4
# chosen, not fitted: a finding is reported once it has lasted for so long, and cleared once it has been over for so long; a part
# of the 1 s after which rotations of 5 deg are reported (docs/evidence/calibration.md). Without it another person who is taken
# for this one for 0.7 s has a camera named in 2 of 10 simulated walks (1 with it), and for 1 s in 4 (2)
_SURE_AFTER_S = 0.6
# chosen, not fitted: redundant coordinates before anything is suspected; 14 keypoints in four cameras give 70 in each time step
_LEAST_COUNT = 200.0
# with two cameras the faulty one cannot be identified
LEAST_CAMERAS = 3
# margin to the second-best explanation, as a share of the threshold
_APART = 0.5
# distance between rays above which no rotation or delay is the explanation, and cameras may be swapped
_GROSS_M, _MAY_BE_SWAPPED_M, _NOT_LINEAR = 0.1, 0.06, 0.25
# chosen, not fitted: newest time steps that are tried with cameras swapped; and the swap must leave less than this share of
# the distance between rays
_SWAP_TIME_STEPS, _SWAP_GAIN = 10, 0.4
_NEWEST_APART_S = 1.0


@dataclass(frozen=True, kw_only=True)
class RigFinding:
    """Something is wrong with a camera.

    Attributes:
        kind: ``moved``, ``unsynchronised`` or ``swapped``; of a recording also ``unfit``: none of these. cameras: which.
        t_ns: when it was noticed.
        detail: one line with numbers. displaced_m: distance of the rays from the person. amount: rotation in rad, or delay in s.
    """

    kind: str
    cameras: tuple[str, ...]
    t_ns: int
    detail: str
    displaced_m: float
    amount: float = 0.0


@dataclass(frozen=True, eq=False, kw_only=True)
class MonitorState:
    """State of the monitor.

    Attributes:
        sums: one per memory. steps: what each time step of the longest memory adds to them, and when. before: up to two time
            steps, the newer last. recent: points of the newest time steps, (C, P, 2) each.
        finding: the present one; None while the rig is healthy. well_ns: since when it seems to be over.
        doubt: kind and cameras that are reported if it lasts, since `since_ns`.
        others: state of the cameras that are not reported, while some are.
    """

    sums: tuple[Sums, ...]
    steps: tuple[tuple[int, Sums], ...] = ()
    before: tuple[TriangulatedStep, ...] = ()
    recent: tuple[Array, ...] = ()
    finding: RigFinding | None = None
    well_ns: int | None = None
    doubt: tuple[str, tuple[str, ...]] | None = None
    since_ns: int = 0
    others: MonitorState | None = None

    @property
    def findings(self) -> tuple[RigFinding, ...]:
        """All present findings."""
        if self.finding is None:
            return ()
        return (self.finding, *(self.others.findings if self.others is not None else ()))


def new_monitor_state(rig: Rig) -> MonitorState:
    """Nothing seen yet."""
    return MonitorState(sums=tuple(Sums.nothing(len(rig)) for _ in MEMORIES_S))


def observe(state: MonitorState, rig: Rig, t_ns: int, xy_img: Array) -> tuple[MonitorState, list[RigFinding]]:
    """Take in matched points (C, P, 2) raw px of one time step (NaN where unseen); P stays the same from call to call.

    Returns:
        The next state, whose `findings` are all present ones, and those that are new.
    """
    now = instant_of(rig, t_ns, xy_img)
    recent = (*state.recent, np.array(xy_img, np.float64))[-_SWAP_TIME_STEPS:]
    apart_s = [(now.t_ns - one.t_ns) / 1e9 for one in state.before]
    if len(apart_s) < 2 or not 0 < apart_s[1] < apart_s[0] < _NEWEST_APART_S:
        return replace(state, before=(*state.before, now)[-2:] if apart_s and apart_s[-1] > 0 else (now,), recent=recent), []
    older, middle = state.before
    new = sums_of(rig, middle, (now.xyz_world - older.xyz_world) / apart_s[0])
    sums = tuple(old.decayed(float(np.exp(-apart_s[1] / m)), new) for old, m in zip(state.sums, MEMORIES_S, strict=True))
    steps = tuple(one for one in (*state.steps, (t_ns, new)) if t_ns - one[0] < MEMORIES_S[-1] * 1e9)
    state = replace(state, sums=sums, steps=steps, before=(middle, now), recent=recent)
    return _judged(state, rig, t_ns) if state.finding is None else _gone_on(state, state.finding, rig, t_ns, xy_img)


@dataclass(frozen=True, kw_only=True)
class Suspect:
    """What would be wrong with a camera, if anything is.

    Attributes:
        kind: ``moved`` or ``unsynchronised``. camera: its index. unknowns: rotation (3,) in rad, or delay (1,) in s.
        displaced_m: by how much that displaces the person in its views, at the person.
        gain: squared residuals it explains, of m^2. left: those it does not. sure: the gain in units of the variance per degree
            of freedom.
    """

    kind: str
    camera: int
    unknowns: Array
    displaced_m: float
    gain: float
    left: float
    sure: float

    @property
    def amount(self) -> float:
        """Rotation in rad, or delay in s with its sign."""
        return float(self.unknowns[0]) if self.kind == UNSYNCHRONISED else float(np.linalg.norm(self.unknowns))


def suspects(sums: Sums) -> list[Suspect]:
    """What the rotation and the delay of each camera explain, each alone."""
    found = []
    # whatever all rotations explain is taken away from what a delay may explain
    for kind, unknowns, left in ((MOVED, TURN, sums), (UNSYNCHRONISED, LATE, sums.without(TURN))):
        solved, displaced_m, gain, scatter = _explained(left, unknowns)
        unexplained = np.maximum(left.squares - gain, 1e-12)
        # lasting errors look like a rotation and never like a delay: there every time step is a new measurement
        sure = gain / (scatter if kind == MOVED else unexplained / max(left.count, 1e-9))
        found += [
            Suspect(
                kind=kind,
                camera=c,
                unknowns=solved[c],
                displaced_m=float(displaced_m[c]),
                gain=float(gain[c]),
                left=float(unexplained[c]),
                sure=float(sure[c]),
            )
            for c in range(len(sure))
        ]
    return found


def _explained(sums: Sums, unknowns: slice) -> tuple[Array, Array, Array, Array]:
    """Of each camera alone: rotation (C, 3) in rad or delay (C, 1) in s, the displacement (C,) it causes in m, the squared
    residuals (C,) it explains, and what keypoints, each alone, explain of what is left (C,), per degree of freedom.

    A camera that was moved displaces all keypoints alike; a network's errors last as long as a body is seen from the same side,
    and differ from keypoint to keypoint. So the last is the variance to which the gain is compared.
    """
    each = np.arange(len(sums.points))
    between = sums.information.reshape(-1, len(each), UNKNOWNS, len(each), UNKNOWNS)[:, :, unknowns, :, unknowns]
    pull = sums.pull.reshape(-1, len(each), UNKNOWNS)[:, :, unknowns]
    alone, one = np.moveaxis(between[:, each, :, each], 0, 1), np.eye(between.shape[-1])
    found = np.linalg.solve(alone.sum(axis=0) + 1e-6 * one, pull.sum(axis=0)[..., None])[..., 0]
    squares = np.einsum("cu,cuv,cv->c", found, sums.own[:, unknowns, unknowns], found)
    gain = (pull.sum(axis=0) * found).sum(axis=1)
    # a keypoint alone hardly determines a rotation about the ray to it
    determined = alone + (_DETERMINED * np.trace(alone, axis1=2, axis2=3)[..., None, None] / len(one) + 1e-9) * one
    left = pull - np.einsum("pdvcu,cu->cpdv", between, found)
    scatter = np.einsum("cpdu,pduv,cpdv->c", left, np.linalg.inv(determined), left, optimize=True)
    freedom = np.trace(np.linalg.solve(determined, alone), axis1=2, axis2=3).sum() - len(one)
    displaced_m = np.sqrt(squares / np.maximum(sums.points, 1e-9))
    return found, displaced_m, gain, np.maximum(scatter, 1e-12) / np.maximum(freedom, 1e-9)


def _judged(state: MonitorState, rig: Rig, t_ns: int) -> tuple[MonitorState, list[RigFinding]]:
    found = _suspected(state, rig)
    if found is None:
        return replace(state, doubt=None), []
    if state.doubt != (found.kind, found.cameras):
        return replace(state, doubt=(found.kind, found.cameras), since_ns=t_ns), []
    if (t_ns - state.since_ns) / 1e9 < _SURE_AFTER_S:
        return state, []
    found = replace(found, t_ns=t_ns)
    return replace(state, finding=found, well_ns=None, doubt=None, others=new_monitor_state(rig)), [found]


def _suspected(state: MonitorState, rig: Rig) -> RigFinding | None:
    """The one explanation that accounts for most of the residuals, if there is one."""
    short = state.sums[0]
    if (short.points > 0).sum() < LEAST_CAMERAS or short.count < _LEAST_COUNT:
        return None
    apart_m = _misfit_over(rig, state.recent) if _misfit_m(short) > _MAY_BE_SWAPPED_M else 0.0
    if apart_m > _MAY_BE_SWAPPED_M:
        pairs, _ = swapped_cameras(
            rig, lambda order: _misfit_over(rig, [xy_img[order] for xy_img in state.recent]), _SWAP_GAIN * apart_m
        )
        if pairs:
            return _swapped(rig, pairs, apart_m)
    worst = [_worst(state, memory) for memory in range(len(MEMORIES_S))]
    sure = [one for one in worst if one is not None]
    return _named(rig, max(sure, key=lambda one: one.sure)) if sure else None


def _worst(state: MonitorState, memory: int) -> Suspect | None:
    """The best explanation of the residuals; None where it is not sure, or another camera explains about as much."""
    sums = state.sums[memory]
    found = suspects(sums)
    for kind in (UNSYNCHRONISED, MOVED):
        second, worst = sorted((one for one in found if one.kind == kind), key=lambda one: one.sure)[-2:]
        least_m = _STANDING_M if kind == MOVED and sums.walked_m < _STANDS_M else _LEAST_M
        if (
            worst.sure >= max(_SURE, second.sure + _APART * _SURE)
            and worst.displaced_m >= least_m
            # no rotation explains a camera that looks at another person; a large one is not quite linear
            and worst.left <= sums.count * max(_GROSS_M, _NOT_LINEAR * worst.displaced_m) ** 2
            and _lasts(worst, sums, state.steps, MEMORIES_S[memory])
        ):
            return worst
    return None


def _lasts(suspect: Suspect, sums: Sums, steps: Sequence[tuple[int, Sums]], memory_s: float) -> bool:
    """Whether most time steps of the last seconds show a rotation or delay by themselves, each counting by what it could show,
    and of a rotation those of the newer half, too.

    A camera that was moved shows it in all of them; one that takes another person for this one, for some tenths of a second, does
    not (0.7 s in each of 20 simulated walks: a camera was named in 10 when delays were not asked, and in 1 now). A delay shows
    only in those in which the person moves, so it need not be in the newer half (50 ms on a rendered walk: 3.6 s, 5.8 with it).
    """
    begin, unknowns = UNKNOWNS * suspect.camera, TURN if suspect.kind == MOVED else LATE
    before, change = np.zeros((2, UNKNOWNS * len(sums.points)))
    change[begin + unknowns.start : begin + unknowns.stop] = suspect.unknowns
    if suspect.kind == UNSYNCHRONISED:
        left, before = sums.taken_up(TURN)
        change = change @ left
    shown = newer = 0.0
    for t_ns, one in steps:
        age_s = (steps[-1][0] - t_ns) / 1e9
        if age_s < memory_s:
            information = one.information.sum(axis=0)
            could = change @ information @ change
            shows = min(2 * (one.pull.sum(axis=0) - information @ before) @ change - could, could)
            shown, newer = shown + shows, newer + shows * (age_s < memory_s / 2)
    return shown > 0 and (newer > 0 or suspect.kind == UNSYNCHRONISED)


def _misfit_m(sums: Sums) -> float:
    return float(np.sqrt(sums.squares / sums.count)) if sums.count > 0 else 0.0


def _named(rig: Rig, suspect: Suspect) -> RigFinding:
    name, off_mm = rig.names[suspect.camera], 1e3 * suspect.displaced_m
    if suspect.kind == UNSYNCHRONISED:
        words = f"{name} is unsynchronised: its images lag by about {1e3 * suspect.amount:+.0f} ms"
    else:
        degrees = np.rad2deg(suspect.amount)
        words = f"{name} is off by {off_mm:.0f} mm ({degrees:.1f} deg) compared with the other cameras: was it moved?"
    return RigFinding(
        kind=suspect.kind, cameras=(name,), t_ns=0, detail=words, displaced_m=suspect.displaced_m, amount=suspect.amount
    )


def _swapped(rig: Rig, pairs: list[tuple[int, int]], gross_m: float) -> RigFinding:
    cameras = tuple(rig.names[c] for c in sorted({c for pair in pairs for c in pair}))
    return RigFinding(
        kind=SWAPPED,
        cameras=cameras,
        t_ns=0,
        detail=f"{pairs_in_words(rig, pairs)} appear to be swapped: check the cables",
        displaced_m=gross_m,
    )


def _gone_on(
    state: MonitorState, finding: RigFinding, rig: Rig, t_ns: int, xy_img: Array
) -> tuple[MonitorState, list[RigFinding]]:
    """The state with its finding updated, and new findings of the other cameras; without the finding once it has been over
    for a while."""
    assert state.others is not None
    named = np.isin(rig.names, finding.cameras)
    others, new = observe(state.others, rig, t_ns, np.where(named[:, None, None], np.nan, xy_img))
    state = replace(state, others=others)
    if state.sums[0].count < _LEAST_COUNT:
        return state, new
    worse, now_m = _by_now(state.sums[0], finding, rig)
    if now_m > _LEFT * worse.displaced_m:
        return replace(state, finding=worse, well_ns=None), new
    if state.well_ns is None or (t_ns - state.well_ns) / 1e9 < _SURE_AFTER_S:
        return replace(state, well_ns=t_ns if state.well_ns is None else state.well_ns), new
    # the windows still hold the residuals of the time before
    return replace(new_monitor_state(rig), before=state.before), []


def _by_now(sums: Sums, finding: RigFinding, rig: Rig) -> tuple[RigFinding, float]:
    """A finding with its largest displacement so far, and the present displacement."""
    if finding.kind == SWAPPED:
        now_m = _misfit_m(sums)
        return replace(finding, displaced_m=max(finding.displaced_m, now_m)), now_m
    camera = rig.names.index(finding.cameras[0])
    [now] = [one for one in suspects(sums) if one.camera == camera and one.kind == finding.kind]
    if now.displaced_m > finding.displaced_m:
        return replace(_named(rig, now), t_ns=finding.t_ns), now.displaced_m
    if finding.kind == UNSYNCHRONISED:
        # a delay cannot be seen while the person stands still
        would_m = now.displaced_m * abs(finding.amount) / max(abs(now.amount), 1e-9)
        return finding, finding.displaced_m * (abs(now.amount / finding.amount) if would_m > _LEAST_M else 1.0)
    return finding, now.displaced_m


def _misfit_over(rig: Rig, recent: Sequence[Array]) -> float:
    return known_median(instant_of(rig, 0, np.concatenate(recent, axis=1)).misfit_m, np.inf)
