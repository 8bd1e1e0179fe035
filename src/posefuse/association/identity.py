"""Identity that lasts: which person a followed track is, decided from what does not change about a body.

Association follows tracks from frame to frame. A track ends when the person is out of sight for too long, and two tracks can be
swapped while two people touch. This module names tracks: a pure function from one frame to the next with an explicit state,
the same for recordings and live.

- A track that begins may be a person who left. While more than one person is possible, it stays unnamed for a few frames, and
  all unnamed tracks are named together.
- Two tracks that touch keep both readings, as they were and swapped. What is measured after they part decides.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations

import numpy as np
from scipy.optimize import linear_sum_assignment

from posefuse.core import Pose3D
from posefuse.core.arrays import Array

from .memory import median_known
from .traits import Traits, body_lengths_m, plausible_share, sameness

UNNAMED = -1
# frames of a track that decide its identity among several people; fewer are enough above this log-likelihood ratio: without it,
# of three simulated people in their clothes who return within half a second, 93 % of the frames are named rightly, not all
_NAMING_FRAMES, _SURE_FRAMES, _SURE_EVIDENCE = 8, 4, 4.0
# tracks closer than this touch, and have parted beyond that: middles of bodies
_TOUCH_M, _PARTED_M = 0.6, 0.75
# frames after parting from which a swap can be seen, how often it is looked for, and the log-likelihood ratio it takes
_SWAP_FRAMES, _SWAP_EVERY, _SWAP_EVIDENCE = 10, 5, 6.0
# after so many frames apart without such evidence, nothing was swapped
_STRAIGHT_FRAMES = 30


@dataclass(frozen=True, eq=False, kw_only=True)
class Track:
    """A track in progress.

    Attributes:
        person: who it is; `UNNAMED`: not decided yet. begin_ns, seen_ns: first and newest measurement.
        traits: learnt since it began, or since it last touched another track. middle: (3,) of the body, newest.
        touched: the tracks it touched since then, each with the time at which they were closest.
    """

    person: int
    begin_ns: int
    seen_ns: int
    traits: Traits
    middle: Array
    touched: Mapping[int, tuple[int, float]] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class Named:
    """A decision: from `since_ns` on this track is this person."""

    track: int
    person: int
    since_ns: int


@dataclass(frozen=True, eq=False, kw_only=True)
class Identity:
    """Who the tracks are. A value: `after` gives the next one.

    Attributes:
        people_max: how many people there can be. lost_after_s: a track not seen for so long has ended.
        tracks: by number. people: traits of everybody ever named, by person id. left_ns: when the tracks of those who are
            away were last measured.
        names: every decision so far, in order.
    """

    people_max: int
    lost_after_s: float
    tracks: Mapping[int, Track] = field(default_factory=dict)
    people: Mapping[int, Traits] = field(default_factory=dict)
    left_ns: Mapping[int, int] = field(default_factory=dict)
    names: tuple[Named, ...] = ()

    def person_of(self, track: int) -> int:
        """Who the track is as far as is known now; `UNNAMED` before that is decided."""
        return self.tracks[track].person if track in self.tracks else UNNAMED

    def after(self, pose: Pose3D, clothing: Array) -> Identity:
        """The state after a frame in which `pose` (person_id holds tracks) was measured.

        Args:
            pose: of this frame. clothing: (N, 9) of its people, NaN where unknown, see `traits.clothing_traits`.
        """
        found = np.any(np.isfinite(pose.xyz_world[..., 0]), axis=1)
        lengths = body_lengths_m(pose.xyz_world, pose.skeleton)
        measured = np.concatenate([lengths, clothing], axis=1)
        state = self._without_ended(pose.t_ns)
        tracks = dict(state.tracks)
        for row in np.flatnonzero(found):
            number = int(pose.person_id[row])
            usable = plausible_share(lengths[row : row + 1])[0] > 0.5
            tracks[number] = _seen(tracks.get(number), pose.t_ns, measured[row], median_known(pose.xyz_world[row]), usable)
        state = replace(state, tracks=tracks)._touching(pose.t_ns, [int(pose.person_id[row]) for row in np.flatnonzero(found)])
        return state._swapped()._named()

    def _without_ended(self, t_ns: int) -> Identity:
        """What ended tracks taught stays with their people."""
        ended = {n: one for n, one in self.tracks.items() if (t_ns - one.seen_ns) * 1e-9 > self.lost_after_s}
        people, left_ns = dict(self.people), dict(self.left_ns)
        for one in ended.values():
            left_ns[one.person] = one.seen_ns
            if one.person != UNNAMED and not one.touched:
                people[one.person] = people[one.person].pooled(one.traits)
        kept = {n: one for n, one in self.tracks.items() if n not in ended}
        return replace(self, people=people, left_ns=left_ns, tracks=kept)

    def _touching(self, t_ns: int, now: list[int]) -> Identity:
        """Note which tracks touch: what they had learnt goes to their people, and learning starts again."""
        tracks, people = dict(self.tracks), dict(self.people)
        for a, b in combinations(now, 2):
            apart_m = float(np.linalg.norm(tracks[a].middle - tracks[b].middle))
            if apart_m > _PARTED_M or (apart_m > _TOUCH_M and b not in tracks[a].touched):
                continue
            for one, other in ((a, b), (b, a)):
                track = tracks[one]
                if track.person != UNNAMED and not track.touched:
                    people[track.person] = people[track.person].pooled(track.traits)
                nearest = min(track.touched.get(other, (t_ns, np.inf)), (t_ns, apart_m), key=lambda pair: pair[1])
                tracks[one] = replace(
                    track, traits=Traits.unknown(len(track.traits.mean)), touched={**track.touched, other: nearest}
                )
        return replace(self, tracks=tracks, people=people)

    def _swapped(self) -> Identity:
        """Swap the identities of two tracks that touched where measurements since then support it."""
        state = self
        for a, b in combinations(sorted(self.tracks), 2):
            if b in state.tracks[a].touched:
                state = state._decided(a, b)
        return state

    def _decided(self, a: int, b: int) -> Identity:
        one, two = self.tracks[a], self.tracks[b]
        frames = min(one.traits.frames.max(initial=0), two.traits.frames.max(initial=0))
        # frame by frame the answer hardly changes
        if frames < _SWAP_FRAMES or frames % _SWAP_EVERY or UNNAMED in (one.person, two.person):
            return self
        mine, theirs = self.people[one.person], self.people[two.person]
        straight = sameness(one.traits, mine) + sameness(two.traits, theirs)
        crossed = sameness(one.traits, theirs) + sameness(two.traits, mine)
        if abs(crossed - straight) < _SWAP_EVIDENCE and frames < _STRAIGHT_FRAMES:
            return self
        since_ns = one.touched[b][0]
        tracks = dict(self.tracks)
        tracks[a] = replace(one, touched={n: at for n, at in one.touched.items() if n != b})
        tracks[b] = replace(two, touched={n: at for n, at in two.touched.items() if n != a})
        if crossed - straight < _SWAP_EVIDENCE:
            return replace(self, tracks=tracks)
        tracks[a], tracks[b] = replace(tracks[a], person=two.person), replace(tracks[b], person=one.person)
        named = (Named(track=a, person=two.person, since_ns=since_ns), Named(track=b, person=one.person, since_ns=since_ns))
        return replace(self, tracks=tracks, names=(*self.names, *named))

    def _named(self) -> Identity:
        """Name the tracks that can be named: at once where only one person is possible, else together by their traits."""
        unnamed = sorted(n for n, one in self.tracks.items() if one.person == UNNAMED)
        if not unnamed:
            return self
        held = {one.person for one in self.tracks.values()}
        absent = [person for person in sorted(self.people) if person not in held]
        unused = max(self.people, default=-1) + 1
        strangers = list(range(unused, min(unused + len(unnamed), self.people_max)))
        options = absent + strangers
        sure = not absent or (len(options) == 1 and len(unnamed) == 1)
        likely = self._likely(unnamed, options, len(absent))
        ready = [row for row, n in enumerate(unnamed) if sure or self._can_be_named(n, likely[row])]
        if not ready or not options:
            return self
        return self._with_names([unnamed[row] for row in ready], options, likely[ready])

    def _likely(self, tracks: list[int], options: list[int], known: int) -> Array:
        """(tracks, options) log-likelihood ratios; 0 for strangers, which follow the first `known` options."""
        unlike = [0.0] * (len(options) - known)
        return np.array([[sameness(self.tracks[n].traits, self.people[one]) for one in options[:known]] + unlike for n in tracks])

    def _can_be_named(self, number: int, likely: Array) -> bool:
        frames = self.tracks[number].traits.frames.max(initial=0)
        second, best = np.sort(likely)[-2:] if len(likely) > 1 else (0.0, 0.0)
        return bool(frames >= _NAMING_FRAMES or (frames >= _SURE_FRAMES and best - second >= _SURE_EVIDENCE))

    def _with_names(self, ready: list[int], options: list[int], likely: Array) -> Identity:
        # of equally likely strangers the lowest id
        rows, columns = linear_sum_assignment(-(likely - 1e-9 * np.arange(len(options))))
        tracks, people, named = dict(self.tracks), dict(self.people), []
        for row, column in zip(rows, columns, strict=True):
            number, person = ready[row], options[column]
            people.setdefault(person, Traits.unknown(len(tracks[number].traits.mean)))
            tracks[number] = replace(tracks[number], person=person)
            # no one is in two places: before the person's last track ended, this one was another person
            since_ns = max(tracks[number].begin_ns, self.left_ns.get(person, tracks[number].begin_ns - 1) + 1)
            named.append(Named(track=number, person=person, since_ns=since_ns))
        return replace(self, tracks=tracks, people=people, names=(*self.names, *named))


def persons_at(names: Iterable[Named], tracks: Array, t_ns: Array) -> Array:
    """(R,) who tracks (R,) were at these times (R,), as the newest decisions have it; `UNNAMED` where that was never decided."""
    order = np.argsort(tracks, kind="stable")
    in_order, people = tracks[order], np.full(len(tracks), UNNAMED)
    for one in names:
        rows = order[np.searchsorted(in_order, one.track) : np.searchsorted(in_order, one.track, "right")]
        people[rows[t_ns[rows] >= one.since_ns]] = one.person
    return people


def with_persons(pose: Pose3D, persons: Sequence[int]) -> Pose3D:
    """The same pose with other ids (N,), in their order; people that are `UNNAMED` are left out."""
    rows = sorted((row for row, person in enumerate(persons) if person != UNNAMED), key=lambda row: persons[row])
    people = pose.people(np.array(rows, np.int64))
    return replace(people, person_id=np.array([persons[row] for row in rows], np.int64))


def _seen(track: Track | None, t_ns: int, traits: Array, middle: Array, usable: bool) -> Track:
    if track is None:
        track = Track(person=UNNAMED, begin_ns=t_ns, seen_ns=t_ns, traits=Traits.unknown(len(traits)), middle=middle)
    learnt = track.traits.with_frame(traits) if usable else track.traits
    return replace(track, seen_ns=t_ns, traits=learnt, middle=np.where(np.isfinite(middle), middle, track.middle))
