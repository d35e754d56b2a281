"""Numbered live messages: made once, kept for resuming, handed to any number of subscribers.

A subscriber that reads too slowly loses the oldest measurements and states first, then forecasts
and health; it never loses an alarm or a job. If those alone overflow its queue it is cut off with
a reason, so that it comes back and starts from a fresh snapshot.
"""

import asyncio
import threading
import uuid
from bisect import bisect_right
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from itertools import islice
from operator import attrgetter

import msgspec
from pydantic_core import to_json

from adapters.protocol import Clock
from service.bus.followed import Followed
from service.bus.subscription import Message, Subscription
from service.clock import rfc3339, wall_us
from service.documents.messages import Heartbeat, MessageType

HISTORY_MESSAGES = 4096
HISTORY_BYTES = 4 * 1024 * 1024
SUBSCRIPTION_MESSAGES = 256
HEARTBEAT_S = 15.0


class _Envelope(msgspec.Struct):
    """What a message keeps under another number."""

    time: str
    sent_at: str
    data: msgspec.Raw


_read_envelope = msgspec.json.Decoder(_Envelope)


class LiveMessages:
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
        """Record those who follow some assets, or all, on a copy of this bus.

        Returns
        -------
        int
            Number after which there are all messages of these assets.
        """
        return self._followed_elsewhere.note(assets, self._seq)

    def is_followed(self, asset: str) -> bool:
        """See `service.documents.interfaces.LivePublisher.is_followed`."""
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
            begin = bisect_right(self._history, seq, key=attrgetter("seq"))
            return list(islice(self._history, begin, begin + most)), self._forgotten_seq

    def _hand_out(self, message: Message) -> None:
        if message.type != "heartbeat":
            self._remember(message)
        self._on_message(message)
        self._send(message)

    def _send(self, message: Message) -> None:
        for subscription in list(self._subscriptions):
            if not subscription.wants(message):
                continue
            if subscription.put(message):
                subscription.wake()
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
            Number after which there are all messages of the assets; before it none was asked for.
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
                self._lock,
                self._forget,
                wanted,
                start_seq,
                gap,
                capacity + len(missed),
                of_types,
                None if live is None else frozenset(live),
            )
            for message in missed:
                if subscription.wants(message):
                    subscription.put(message)
                    subscription.missed += 1
            if self._closed is None:
                self._subscriptions.add(subscription)
            else:
                subscription.end(self._closed)
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
            # A gap that was reported since is newer than what leaves the history now.
            self._forgotten_seq = max(self._forgotten_seq, oldest.seq)

    def _forget(self, subscription: Subscription) -> None:
        with self._lock:
            self._subscriptions.discard(subscription)


async def heartbeats(bus: LiveMessages, every_s: float = HEARTBEAT_S) -> None:
    """Send a heartbeat to every subscriber, every so many wall seconds, until cancelled."""
    while True:
        await asyncio.sleep(every_s)
        bus.publish("heartbeat", None, Heartbeat())
