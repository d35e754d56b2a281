"""Sources whose clocks are ahead of ours.

A sample from the future would hide what comes after it until its time has come. Its own time is
wrong, and when it was received is known: the samples that a channel sends with it are moved back
together so that the newest is of the time of its receipt, and good ones become uncertain.
"""

import math
import time
from array import array
from bisect import insort
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from operator import itemgetter

import structlog

from adapters.samples import Quality, Sample, is_good
from adapters.times import source_limit_us

Key = tuple[str, str]
"""Asset and channel."""
_Row = tuple[int, float | None, int]

#: Wall seconds after the last sample from the future for which old samples of its channel are
#: doubted, and one that is sent again is known; a push that was refused comes again within 60 s.
DOUBTED_S = 120.0
#: A known clock is right again from here on, in wall seconds: it does not change with each sample.
RIGHT_S = 4.0
#: Older than this a sample says nothing of the present clock, in wall seconds.
OLD_S = 30.0
#: Process seconds for which a source whose clock is ahead, and which has fallen silent, is named.
NAMED_S = 1800.0
_CALLS = 64
_LOG_INTERVAL_S = 10.0
_key = itemgetter(0, 1)
_time_us = itemgetter(0)

_log = structlog.get_logger(__name__)


@dataclass(slots=True)
class _Ahead:
    """A channel whose clock is ahead. Times in microseconds."""

    source: str
    #: By how much its samples are moved back.
    by_us: int
    #: When the latest of them was received.
    heard_us: int
    #: Its last calls and how each was moved: what is sent again is known. Arrays: a service whose
    #: clock is behind has very many.
    calls: "array[int]" = field(default_factory=lambda: array("q"))
    moves_by_us: "array[int]" = field(default_factory=lambda: array("q"))
    moves_since_us: "array[int]" = field(default_factory=lambda: array("q"))
    #: Time and distance of a call that was sent again, or the first one with a right time.
    maybe_right: tuple[int, int] | None = None

    def note(self, call: int, move: "_Move") -> None:
        """Remember how a call was moved."""
        self.calls.append(call)
        self.moves_by_us.append(move.by_us)
        self.moves_since_us.append(move.since_us)
        del self.calls[:-_CALLS], self.moves_by_us[:-_CALLS], self.moves_since_us[:-_CALLS]

    def forget_calls(self) -> None:
        """Take whatever comes next for new."""
        del self.calls[:], self.moves_by_us[:], self.moves_since_us[:]
        self.maybe_right = None

    def move_of(self, call: int) -> "_Move | None":
        """How a call was moved that is known; None where it is not."""
        if call not in self.calls:
            return None
        place = self.calls.index(call)
        return _Move(self.moves_by_us[place], self.moves_since_us[place])


@dataclass(slots=True)
class _Move:
    """What becomes of a channel's samples in one call; `since_us` and newer are moved."""

    by_us: int
    since_us: int


class SourceClocks:
    """Knows which channels are sent by a clock that is ahead, and puts their samples right.

    - ``rate``: process seconds per wall second.
    - ``count``: called for each sample that is moved.
    """

    def __init__(self, rate: float, count: Callable[[], object] = lambda: None) -> None:
        wall_us = max(rate, 1.0) * 1e6
        self.limit_us = source_limit_us(0, rate)
        self._right_us = round(RIGHT_S * wall_us)
        self._doubted_us = round(DOUBTED_S * wall_us)
        self._old_us = round(OLD_S * wall_us)
        self._count = count
        self.known: dict[Key, _Ahead] = {}
        self._quiet_until_s = 0.0

    def ahead_s(self, asset: str, channel: str) -> float | None:
        """Seconds by which the clock behind a channel's latest samples is ahead; None: it is not.

        Seconds of process time.
        """
        found = self.known.get((asset, channel))
        return None if found is None else found.by_us / 1e6

    def by_source(self, now_us: int) -> Mapping[str, dict[str, float]]:
        """By how many seconds the clocks of each source are ahead, by ``asset/channel``.

        What has fallen silent long ago is forgotten.
        """
        found: defaultdict[str, dict[str, float]] = defaultdict(dict)
        for key, one in list(self.known.items()):
            if abs(now_us - one.heard_us) > NAMED_S * 1e6:
                del self.known[key]
            else:
                found[one.source]["/".join(key)] = one.by_us / 1e6
        return found

    def clock_set(self, by_us: int) -> None:
        """Remember for as long as before when each was heard: our clock was set by so much."""
        for one in self.known.values():
            one.heard_us += by_us

    def forget(self, asset: str) -> None:
        """Know nothing of an asset any more: its channels have changed, or it is not followed."""
        for key in [key for key in self.known if key[0] == asset]:
            del self.known[key]

    def put_right(self, samples: Sequence[Sample], source: str) -> Sequence[Sample]:
        """Move back what comes from a clock that is ahead: all samples of one call."""
        call = Call(self, source)
        call.look(samples)
        if call.is_odd:
            call.collect(samples)
        return call.put_right(samples)

    # ------------------------------------------------------------------ one channel in one call
    def move(self, key: Key, source: str, rows: Sequence[_Row], received_us: int) -> _Move | None:
        """Say what becomes of a channel's samples of one call; None: they are as they should be.

        ``rows``: in the order of their times.
        """
        known, newest_us = self.known.get(key), rows[-1][0]
        ahead_us = newest_us - received_us
        if known is not None and not self._is_doubted(known, received_us):
            known.forget_calls()
        call = hash(tuple(rows))
        before = None if known is None else known.move_of(call)
        is_doubted = known is not None and self._is_doubted(known, received_us)
        if ahead_us > (self._right_us if is_doubted else self.limit_us):
            return before or self._moved(key, source, rows, received_us, call)
        if known is None:
            return None
        if before is not None and not self._is_right(known, newest_us, ahead_us):
            return before
        if before is None and is_doubted and ahead_us < -self._old_us:
            return _Move(0, newest_us)  # the same clock may have kept them
        del self.known[key]
        self._report("source_clock_right", key, 0.0)
        return None

    def _is_right(self, known: _Ahead, newest_us: int, ahead_us: int) -> bool:
        """Whether a call that was sent before, with the same values, is one of a right clock now.

        Values may stay the same. Then the next ones follow at the same distance; what is sent
        again comes faster.
        """
        if known.maybe_right is None or newest_us < known.maybe_right[0]:
            known.maybe_right = newest_us, ahead_us
        later_us = newest_us - known.maybe_right[0]
        is_steady = abs(ahead_us - known.maybe_right[1]) <= later_us / 4
        return later_us >= self._right_us / RIGHT_S and is_steady

    def _moved(
        self, key: Key, source: str, rows: Sequence[_Row], received_us: int, call: int
    ) -> _Move:
        known, newest_us = self.known.get(key), rows[-1][0]
        by_us = newest_us - received_us
        if known is None:
            known = self.known[key] = _Ahead(source, by_us, received_us)
            self._report("source_clock_ahead", key, by_us / 1e6)
        is_same = abs(by_us - known.by_us) <= self.limit_us
        if not (is_same and self._is_doubted(known, received_us)):
            known.by_us = by_us
        since_us, times_us = rows[0][0], [one[0] for one in rows[-2:]]
        if not known.calls and times_us[0] <= received_us and newest_us - times_us[0] > by_us / 2:
            since_us = newest_us  # one wrong time takes no right ones along
        move = _Move(known.by_us, since_us)
        known.note(call, move)
        known.source, known.maybe_right = source, None
        known.heard_us = max(known.heard_us, received_us)
        return move

    def _is_doubted(self, known: _Ahead, received_us: int) -> bool:
        return abs(received_us - known.heard_us) <= self._doubted_us

    def moved(self, sample: Sample, move: _Move) -> Sample:
        """Move one sample back."""
        quality = Quality.UNCERTAIN if is_good(sample.quality) else sample.quality
        by_us = move.by_us if sample.time_us >= move.since_us else 0
        self._count()
        return sample._replace(time_us=sample.time_us - by_us, quality=int(quality))

    def _report(self, event: str, key: Key, ahead_s: float) -> None:
        now_s = time.monotonic()
        if now_s >= self._quiet_until_s:  # one gateway has many channels
            self._quiet_until_s = now_s + _LOG_INTERVAL_S
            _log.warning(event, asset=key[0], channel=key[1], ahead_s=round(ahead_s) or None)


class Call:
    """The samples that a source sends at once: those of a channel are judged together.

    `look` at all of them, `collect` their times if that `is_odd`, and `put_right`; very many in
    portions.
    """

    def __init__(self, clocks: SourceClocks, source: str) -> None:
        self._clocks = clocks
        self._source = source
        self._rows: dict[Key, list[_Row]] = {}
        self._received_us: dict[Key, int] = {}
        self._moves: dict[Key, _Move] | None = None
        self.is_odd = bool(clocks.known)

    def look(self, samples: Sequence[Sample]) -> None:
        """See whether any sample is of the future."""
        limit_us = self._clocks.limit_us
        for sample in samples:
            if sample[2] - sample[5] > limit_us:
                self._rows.setdefault(_key(sample), [])
                self.is_odd = True

    def collect(self, samples: Sequence[Sample]) -> None:
        """Note the samples of channels that may be ahead."""
        known, rows = self._clocks.known, self._rows
        for sample in samples:
            key = _key(sample)
            if key in rows or key in known:
                value = None if math.isnan(sample.value) else sample.value
                row = sample.time_us, value, int(sample.quality)
                insort(rows.setdefault(key, []), row, key=_time_us)
                self._received_us[key] = sample.received_us

    def put_right(self, samples: Sequence[Sample]) -> Sequence[Sample]:
        """Give samples as they are taken."""
        if not self.is_odd:
            return samples
        clocks = self._clocks
        if self._moves is None:
            found = {
                key: clocks.move(key, self._source, rows, self._received_us[key])
                for key, rows in self._rows.items()
            }
            self._moves = {key: move for key, move in found.items() if move is not None}
        moves = self._moves
        if not moves:
            return samples
        return [
            sample if (move := moves.get(_key(sample))) is None else clocks.moved(sample, move)
            for sample in samples
        ]
