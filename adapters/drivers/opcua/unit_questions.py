"""Asks a server for the units of its nodes, and again where it does not say them."""

import asyncio
import logging
import math
import time
from collections.abc import Collection, Mapping, Sequence

from adapters.backoff import Backoff
from adapters.drivers.opcua.session import Session, SessionError
from adapters.drivers.opcua.units import StatedUnits
from adapters.drivers.opcua.values import FollowedNode
from adapters.units import UnitError, factors_of, needs_unit

logger = logging.getLogger(__name__)

# Wall seconds: values wait for the first answer so long, and the question is repeated.
WAIT_S = 2.0
AGAIN_FIRST_S, AGAIN_LAST_S = 10.0, 600.0
# Few servers say that a unit has changed while a client is connected.
CHECK_S = 600.0
# After so many answers history is fetched as it is, and a node without a unit has none.
MOST_QUESTIONS = 3


class UnitQuestions:
    """Turns values into the units of their channels, as far as the server says its own.

    The scale, the offset and the doubt of each channel follow what it says. A value whose unit is
    not known is doubted; none is kept back for it.

    - ``source``: name of the source, for the log.
    - ``points``: its channels, as they are configured.
    """

    def __init__(self, source: str, points: Sequence[FollowedNode]) -> None:
        self._source = source
        self._points = points
        self._given = [point.config for point in points]
        self._units: dict[str, str] = {}  # of nodes, as the server stated them last
        self._asked: list[str] = []  # nodes whose unit matters
        self._unasked: dict[str, str] = {}  # of these, those whose unit is not known now, and why
        self._without: list[str] = []  # nodes that have none, which may come a little later
        self._answers = 0  # since the connection
        self._ends_connection = False  # the question did, the last time
        self._asking: asyncio.Task[None] | None = None
        self._again = Backoff(AGAIN_FIRST_S, AGAIN_LAST_S)
        self._ask_at = -math.inf  # wall (monotonic) time
        self._asked_at = self._check_at = -math.inf
        self._question: list[str] = []  # nodes of the one under way, or of the last one
        self._changed: set[str] = set()  # since it was put

    @property
    def awaited(self) -> Collection[str]:
        """Nodes whose unit may be said soon: what is fetched of them before stays in doubt."""
        return self._unasked if self._answers < MOST_QUESTIONS else ()

    async def begin(self, session: Session) -> None:
        """Ask for the units of all nodes; a server that is slow to answer keeps no value back.

        Raises `SessionError` if the connection is lost by it.
        """
        if self._ends_connection:  # values come first
            self._ask_at = time.monotonic() + self._again.next()
        else:
            self._again.reset()
            self._ask_at = -math.inf
        self._answers, self._without, self._question = 0, [], []
        self._check_at = time.monotonic() + CHECK_S
        followed = zip(self._points, self._given, strict=True)
        self._asked = [given.node for point, given in followed if needs_unit(given, point.unit)]
        self._doubt(dict.fromkeys(self._asked, "no answer yet"))
        self.go_on(session)
        if self._asking is not None:
            await asyncio.wait({self._asking}, timeout=WAIT_S)
        if session.lost:
            raise SessionError(session.lost)

    def go_on(self, session: Session) -> None:
        """Ask for what the server has not said, when it is time, while values go on.

        What it has said is asked for again now and then.
        """
        if self._asking is not None and not self._asking.done():
            return
        now_s = time.monotonic()
        question: list[str] = []
        if is_check := now_s >= self._check_at:
            question = [node for node in self._asked if node not in self._unasked]
        if not question and now_s >= self._ask_at:
            question, is_check = [*self._unasked, *self._without], False
        if not question:
            return
        self._question = question
        self._changed.clear()
        self._asking = asyncio.create_task(self._ask(session, is_check))

    def doubt(self, nodes: Collection[str]) -> None:
        """Note that the server says that what these nodes hold has another meaning now."""
        changed = {node: "it has changed, no answer yet" for node in nodes if node in self._asked}
        if changed:
            logger.warning("source %s: units have changed: %s", self._source, ", ".join(changed))
            self._changed |= changed.keys()
            self._again.reset()
            self._ask_at = min(self._ask_at, self._asked_at + AGAIN_FIRST_S)
            self._doubt({**self._unasked, **changed})

    async def end(self) -> None:
        """Ask no more on this connection."""
        asking, self._asking = self._asking, None
        if asking is not None:
            asking.cancel()
            await asyncio.gather(asking, return_exceptions=True)

    async def _ask(self, session: Session, is_check: bool) -> None:
        self._asked_at = time.monotonic()
        if is_check:
            self._check_at = self._asked_at + CHECK_S
        else:
            self._ask_at = self._asked_at + self._again.next()
        self._ends_connection = True
        try:
            found = await session.stated_units(self._question)
        except SessionError as error:
            session.lose(str(error))
            return
        except asyncio.CancelledError:  # it was lost otherwise
            self._ends_connection = False
            raise
        self._ends_connection = False
        if is_check:  # no answer is no sign of another unit
            found.unanswered.clear()
        else:
            self._answers += 1
            none = [node for node, unit in found.units.items() if not unit]
            self._without = none if self._answers < MOST_QUESTIONS else []
        for node in self._changed:  # after it was asked, perhaps
            found.units.pop(node, None)
            found.unanswered[node] = self._unasked[node]
        self.take(found)

    def take(self, stated: StatedUnits) -> None:
        """Turn values into the channels' units; what cannot be turned is doubted."""
        answered = {*self._question, *stated.units}
        unanswered = {node: why for node, why in self._unasked.items() if node not in answered}
        unanswered |= stated.unanswered
        for node, unit in stated.units.items():
            before = self._units.get(node, "")
            if before and not unit:  # the server may be about to start
                unanswered[node] = f"none now, {before!r} before"
                continue
            if before and before != unit:
                logger.warning(
                    "source %s: node %s: unit %r, %r before", self._source, node, unit, before
                )
            self._units[node] = unit
        if stated.unanswered:
            logger.info(
                "source %s: the server does not say the units of %d nodes: %s",
                *(self._source, len(stated.unanswered), next(iter(stated.unanswered.values()))),
            )
        self._doubt(unanswered)

    def _doubt(self, unanswered: Mapping[str, str]) -> None:
        """Turn values by the units that are known, and doubt those whose unit is not."""
        self._unasked = dict(unanswered)
        for point, given in zip(self._points, self._given, strict=True):
            factors, doubt = (given.scale, given.offset), ""
            before = point.config, point.doubt
            try:
                factors = factors_of(given, point.unit, self._units.get(given.node, ""))
                if given.node in unanswered and needs_unit(given, point.unit):
                    why = unanswered[given.node]
                    doubt = f"the server does not say its unit: {why}; expected one, or scale"
            except UnitError as error:
                doubt = f"the server has it {error}, or scale"
            keys = {"scale": factors[0], "offset": factors[1]}
            point.config, point.doubt = given.model_copy(update=keys), doubt
            if before != (point.config, point.doubt):
                point.heard_us = 0  # it is read at once
