"""Numbered live messages: made once, kept for resuming, handed to any number of subscribers.

A subscriber that reads too slowly loses the oldest measurements and states first, then forecasts
and health; it never loses an alarm or a job. If those alone overflow its queue it is cut off with
a reason, so that it comes back and starts from a fresh snapshot.
"""

import asyncio
import threading
import uuid
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from itertools import islice

import msgspec
from pydantic_core import to_json

from adapters.protocol import Clock
from service.bus.followed import Followed
from service.clock import rfc3339, wall_us
from service.documents.messages import Heartbeat, MessageType

# What goes first when a subscriber is slow; a message of the last tier never goes.
_TIER: Mapping[MessageType, int] = {
    "heartbeat": 0,
    "measurement": 0,
    "state": 0,
    "forecast": 1,
    "health": 1,
    "verdict": 1,
    "alarm": 2,
    "job": 2,
}
_TIERS = 3
#: What is made only for those who follow the asset.
_ON_DEMAND: frozenset[MessageType] = frozenset({"measurement", "state", "verdict", "forecast"})

HISTORY_MESSAGES = 4096
HISTORY_BYTES = 4 * 1024 * 1024
SUBSCRIPTION_MESSAGES = 256
HEARTBEAT_S = 15.0


@dataclass(frozen=True, slots=True)
class Message:
    """One message as it goes out; the text is made once for all subscribers.

    Attributes
    ----------
    type
        What the data are.
    seq
        Number of the message, counted from 1 at the start of the service.
    asset
        Asset that it is about, None for the service as a whole.
    text
        The JSON text with type, seq, epoch, asset, time, sent_at and data.
    """

    type: MessageType
    seq: int
    asset: str | None
    text: str


class _Envelope(msgspec.Struct):
    """What a message keeps under another number."""

    time: str
    sent_at: str
    data: msgspec.Raw


_read_envelope = msgspec.json.Decoder(_Envelope)


class SubscriptionClosedError(Exception):
    """No more messages come; the text says why."""


class Subscription:
    """The messages waiting for one subscriber. Made by `Bus.subscribe`; read in its event loop.

    Attributes
    ----------
    start_seq
        Number after which this subscription goes on: the resume point, or the latest message.
    gap
        True when messages after the resume point are gone, so that a fresh snapshot is needed.
    dropped
        Messages left out so far because the subscriber was slow.
    missed
        Messages after the resume point that were waiting at the beginning.
    """

    def __init__(
        self,
        bus: "Bus",
        assets: frozenset[str] | None,
        start_seq: int,
        gap: bool,
        capacity: int,
        types: frozenset[MessageType] | None = None,
        live: frozenset[str] | None = None,
    ) -> None:
        self.start_seq = start_seq
        self.gap = gap
        self.dropped = 0
        self.missed = 0
        self._bus = bus
        self._assets = assets
        self._types = types
        self._live = assets if live is None else live
        self._capacity = capacity
        self._tiers: tuple[deque[Message], ...] = tuple(deque() for _ in range(_TIERS))
        self._closed: str | None = None
        self._loop = asyncio.get_running_loop()
        self._thread = threading.get_ident()
        self._something = asyncio.Event()

    @property
    def followed(self) -> frozenset[str] | None:
        """Assets whose live messages are wanted; None for all."""
        live = self._types is None or not self._types.isdisjoint(_ON_DEMAND)
        return self._live if live else frozenset()

    def wants(self, message: Message) -> bool:
        """Tell whether the message is about one of the assets asked for, or about all."""
        if self._types is not None and message.type not in self._types:
            return False
        wanted = self._live if message.type in _ON_DEMAND else self._assets
        return message.asset is None or wanted is None or message.asset in wanted

    async def get(self) -> Message:
        """Wait for the next message, in order of number.

        Raises
        ------
        SubscriptionClosedError
            When the subscription was closed and what had been waiting is read.
        """
        while True:
            message = self._take()
            if message is not None:
                return message
            if self._closed is not None:
                raise SubscriptionClosedError(self._closed)
            await self._something.wait()

    def close(self, reason: str = "closed") -> None:
        """End the subscription; a waiting `get` raises once the queue is empty."""
        self._bus._forget(self)
        self._end(reason)

    def _take(self) -> Message | None:
        with self._bus._lock:
            waiting = [tier for tier in self._tiers if tier]
            if waiting:
                return min(waiting, key=lambda tier: tier[0].seq).popleft()
            if self._closed is None:
                self._something.clear()
            return None

    def _put(self, message: Message) -> bool:
        """Queue a message (the bus holds the lock); False when the subscriber must be cut off."""
        self._tiers[_TIER[message.type]].append(message)
        if sum(map(len, self._tiers)) > self._capacity:
            victims = next((tier for tier in self._tiers[:-1] if tier), None)
            if victims is None:
                return False
            victims.popleft()
            self.dropped += 1
        return True

    def _end(self, reason: str) -> None:
        if self._closed is None:
            self._closed = reason
        self._wake()

    def _wake(self) -> None:
        if threading.get_ident() == self._thread:
            self._something.set()
        elif not self._loop.is_closed():
            self._loop.call_soon_threadsafe(self._something.set)


class Bus:
    """Numbers messages, keeps the latest for resuming and hands them to the subscribers.

    `publish` may be called from any thread.

    Parameters
    ----------
    clock : Clock
        Process time of the messages.
    epoch : str, optional
        Names this start of the service; numbers of different epochs do not compare.
    history_messages, history_bytes : int
        How many messages, and how many bytes of them, are kept for resuming.
    on_message : callable
        Gets every message in the order of its number; must not wait.
    """

    def __init__(
        self,
        clock: Clock,
        epoch: str | None = None,
        *,
        history_messages: int = HISTORY_MESSAGES,
        history_bytes: int = HISTORY_BYTES,
        on_message: Callable[[Message], None] = lambda message: None,
    ) -> None:
        self.epoch = epoch or uuid.uuid4().hex[:12]
        self._clock = clock
        self._lock = threading.RLock()
        self._seq = 0
        self._forgotten_seq = 0  # the highest number that can no longer be resumed from before
        self._history: deque[Message] = deque()
        self._history_bytes = 0
        self._history_limits = (history_messages, history_bytes)
        self._subscriptions: set[Subscription] = set()
        self._closed: str | None = None
        self._on_message = on_message
        self._followed_elsewhere = Followed()

    @property
    def seq(self) -> int:
        """Number of the latest message, 0 before the first."""
        return self._seq

    @property
    def closed(self) -> bool:
        """True once no more messages come."""
        return self._closed is not None

    @property
    def subscribers(self) -> int:
        """How many subscriptions are open."""
        return len(self._subscriptions)

    def follow(self, assets: Iterable[str] | None) -> int:
        """Take note of those who follow some assets, or all, on a copy of this bus.

        Returns
        -------
        int
            Number after which there are all messages of these assets.
        """
        return self._followed_elsewhere.note(assets, self._seq)

    def is_followed(self, asset: str) -> bool:
        """See `service.documents.interfaces.Publisher.is_followed`."""
        if self._followed_elsewhere.has(asset):
            return True
        if not self._subscriptions:
            return False
        here = self.followed()
        return here is None or asset in here

    def followed(self) -> frozenset[str] | None:
        """Assets whose live messages the subscribers of this bus want; None for all."""
        with self._lock:
            wanted = [one.followed for one in self._subscriptions]
        named = [one for one in wanted if one is not None]
        return None if len(named) < len(wanted) else frozenset().union(*named)

    def publish(
        self,
        type: MessageType,
        asset: str | None,
        data: object,
        time_us: int | None = None,
    ) -> Message:
        """Give a message its number and hand it to all who want it.

        Parameters
        ----------
        type : str
            What the data are.
        asset : str or None
            Asset that it is about; None reaches every subscriber.
        data
            A document (`service.documents`), or plain JSON types; NaN and infinities become null.
        time_us : int, optional
            Process time of the data in microseconds; default now.
        """
        body = to_json(data, inf_nan_mode="null").decode()
        with self._lock:
            self._seq += 1
            text = self.envelope(type, self._seq, asset, body, time_us)
            message = Message(type, self._seq, asset, text)
            self._hand_out(message)
        return message

    def mirror(self, message: Message) -> None:
        """Hand out a message that another bus has numbered; an older one is left out."""
        with self._lock:
            if message.seq > self._seq:
                self._seq = message.seq
                self._hand_out(message)

    def renumber(self, message: Message) -> None:
        """Hand out a message of another bus under the next number of this one."""
        envelope = _read_envelope.decode(message.text)
        with self._lock:
            self._seq += 1
            head = {
                "type": message.type,
                "seq": self._seq,
                "epoch": self.epoch,
                "asset": message.asset,
                "time": envelope.time,
                "sent_at": envelope.sent_at,
            }
            text = f'{to_json(head).decode()[:-1]},"data":{bytes(envelope.data).decode()}}}'
            self._hand_out(Message(message.type, self._seq, message.asset, text))

    def announce(self, type: MessageType, asset: str | None, data: object) -> None:
        """Hand out a message beside the numbered ones: it has the number of the latest one."""
        body = to_json(data, inf_nan_mode="null").decode()
        with self._lock:
            text = self.envelope(type, self._seq, asset, body)
            self._send(Message(type, self._seq, asset, text))

    def skip_to(self, seq: int, forgotten_seq: int) -> None:
        """Go on after a number: what came before it is not to be had, or was never kept."""
        with self._lock:
            self._seq = max(self._seq, seq)
            self._forgotten_seq = max(self._forgotten_seq, forgotten_seq)

    def restart(self, epoch: str, reason: str) -> None:
        """Begin another epoch with nothing; every subscription ends."""
        with self._lock:
            self.epoch = epoch
            self._seq = self._forgotten_seq = self._history_bytes = 0
            self._history.clear()
        self.end_subscriptions(reason)

    def end_subscriptions(self, reason: str) -> None:
        """End the subscriptions that there are; new ones are welcome."""
        with self._lock:
            for subscription in list(self._subscriptions):
                subscription.close(reason)

    def after(self, seq: int, most: int) -> tuple[list[Message], int]:
        """The kept messages after a number, at most so many, and what is forgotten."""
        with self._lock:
            kept = (message for message in self._history if message.seq > seq)
            return list(islice(kept, most)), self._forgotten_seq

    def _hand_out(self, message: Message) -> None:
        if message.type != "heartbeat":
            self._remember(message)
        self._on_message(message)
        self._send(message)

    def _send(self, message: Message) -> None:
        for subscription in list(self._subscriptions):
            if not subscription.wants(message):
                continue
            if subscription._put(message):
                subscription._wake()
            else:
                subscription.close("too slow: alarms and jobs alone overflowed the queue")

    def envelope(
        self,
        type: str,
        seq: int,
        asset: str | None,
        body: str,
        time_us: int | None = None,
        extra: Mapping[str, object] | None = None,
    ) -> str:
        """JSON text of a message around the JSON text of its data."""
        head = {
            "type": type,
            "seq": seq,
            "epoch": self.epoch,
            "asset": asset,
            "time": rfc3339(self._clock.now_us() if time_us is None else time_us),
            "sent_at": rfc3339(wall_us()),
            **(extra or {}),
        }
        return f'{to_json(head).decode()[:-1]},"data":{body}}}'

    def subscribe(
        self,
        assets: Iterable[str] | None = None,
        resume_from: int | None = None,
        capacity: int = SUBSCRIPTION_MESSAGES,
        types: Iterable[MessageType] | None = None,
        complete_after: int = 0,
        live: Iterable[str] | None = None,
    ) -> Subscription:
        """Open a subscription in the running event loop.

        Parameters
        ----------
        assets : iterable of str, optional
            Only messages about these (and about the service as a whole); default all.
        resume_from : int, optional
            Number of the last message that the subscriber saw in this epoch. What came after it
            is waiting in the subscription, or its ``gap`` says that it is gone.
        capacity : int
            How many messages may wait.
        types : iterable of str, optional
            Only messages of these types; default all.
        complete_after : int
            Number after which there are all messages of the assets: before it nobody followed.
        live : iterable of str, optional
            Of these alone the messages that are made on demand (measurements, states, verdicts,
            forecasts), and of all ``assets`` the others; default those of ``assets``.
        """
        of_types = None if types is None else frozenset(types)
        wanted = None if assets is None else frozenset(assets)
        with self._lock:
            oldest = max(self._forgotten_seq, complete_after)
            gap = resume_from is not None and not (oldest <= resume_from <= self._seq)
            start_seq = self._seq if gap or resume_from is None else resume_from
            missed = [message for message in self._history if message.seq > start_seq]
            # What is promised by resuming comes on top of what may wait.
            subscription = Subscription(
                self,
                wanted,
                start_seq,
                gap,
                capacity + len(missed),
                of_types,
                None if live is None else frozenset(live),
            )
            for message in missed:
                if subscription.wants(message):
                    subscription._put(message)
                    subscription.missed += 1
            if self._closed is None:
                self._subscriptions.add(subscription)
            else:
                subscription._end(self._closed)
            return subscription

    def close(self, reason: str = "the service is stopping") -> None:
        """End every subscription, now and later."""
        with self._lock:
            self._closed = reason
            self.end_subscriptions(reason)

    def _remember(self, message: Message) -> None:
        self._history.append(message)
        self._history_bytes += len(message.text)
        most_messages, most_bytes = self._history_limits
        while len(self._history) > most_messages or self._history_bytes > most_bytes:
            oldest = self._history.popleft()
            self._history_bytes -= len(oldest.text)
            self._forgotten_seq = oldest.seq

    def _forget(self, subscription: Subscription) -> None:
        with self._lock:
            self._subscriptions.discard(subscription)


async def heartbeats(bus: Bus, every_s: float = HEARTBEAT_S) -> None:
    """Send a heartbeat to every subscriber, every so many wall seconds, until cancelled."""
    while True:
        await asyncio.sleep(every_s)
        bus.publish("heartbeat", None, Heartbeat())
