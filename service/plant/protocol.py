"""What a publisher is: whatever hands tags and alarms on to other systems.

A publisher is a folder of this package with one line in `service.plant.publishers.PUBLISHERS`.
It gets values and gives none back: it holds no twin, and of the store only what reads a history,
so that nothing that a stranger sends to it can change anything.
"""

from collections.abc import Awaitable, Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, Protocol, TypedDict, runtime_checkable

from service.clock import wall_us
from service.site.settings import Settings

if TYPE_CHECKING:  # the supervisor asks what is enabled, and needs no store for it
    from service.security.audit_trail import AuditTrail
    from service.security.authenticator import Authenticator
    from service.store.channel_history import ChannelHistory


class TagValue(TypedDict):
    """A tag as `GET /assets/{id}/snapshot` shows it."""

    value: float | None
    unit: str
    #: The OPC DA quality byte.
    quality: int
    #: RFC 3339, UTC.
    time: str


async def _not_known() -> None:
    """No one to ask for the open alarms."""


@dataclass(frozen=True)
class Host:
    """What a publisher may use of the service.

    - ``authenticator``, ``trail``: check the keys of callers, and keep a line of wrong ones.
    - ``data_dir``: a publisher keeps files in the folder of its own name below it.
    - ``tags_of``: the tags of an asset at this moment, as its snapshot: what is old is not called
      good, and no verdict of it is safe. None without such an asset, or before its first snapshot.
    - ``open_alarms``: the alarms that are not over, as `GET /alarms` shows them; None while the
      cell does not answer.
    - ``is_known``: whether there is such an asset, also one whose cell has not answered yet.
    """

    authenticator: "Authenticator"
    trail: "AuditTrail"
    data_dir: Path
    tags_of: Callable[[str], Mapping[str, TagValue] | None] = lambda asset: None
    channels_of: Callable[[str], Collection[str]] = lambda asset: ()
    history: "ChannelHistory | None" = None
    now_us: Callable[[], int] = wall_us
    open_alarms: Callable[[], Awaitable[Sequence[Mapping[str, object]] | None]] = _not_known
    is_known: Callable[[str], bool] = lambda asset: False


class Publisher(Protocol):
    """Hands tags and alarms on to other systems.

    Life cycle
    ----------
    Made by the `make` of its `PublisherEntry`; that opens nothing. Then, again and again until the
    service stops::

        open -> all tags, asset by asset -> run next to changed tags and alarms -> close

    - `open` is called once per round, and nothing else before it has returned.
    - The first `publish_tags` of an asset after `open` brings all tags that it has (a birth
      certificate, a fresh register map). Later calls bring those that changed, or are new.
    - Assets come and go during a round. The tags of a new asset come as those of the others did.
      Tags of a removed asset, or of a node that the active model does not have any more, come once
      more without a value and with a bad quality; then `withdraw_tags` has their names. So do
      those of an earlier round, which this round has not published, and, where the publisher is
      `Keeping`, of an earlier process.
    - `run` begins after the first tags, so that a server never shows assets without values. It
      goes on until it is cancelled, or raises when the round is over (a lost connection).
    - `publish_tags`, `withdraw_tags` and `publish_alarm` may be called at the same time as `run`,
      and alarms at the same time as tags, but there is one call for tags and one for alarms at a
      time. They return when the values have been taken: a slow receiver
      delays the next call, and values that changed meanwhile come once, as they are then.
    - Whatever is raised by any of them ends the round: `close` is called, after a growing wait
      `open` follows. An alarm that was not taken comes again in the next round; alarms wait in
      order meanwhile.
    - `close` is called exactly once for each call of `open`, also for one that failed, also while
      the service stops. It must not raise, and returns within a second or two.

    All are called in one event loop; none may block it.
    """

    async def open(self, host: Host) -> None:
        """Connect, or prepare to listen."""

    async def run(self) -> None:
        """Do what is to be done next to publishing, until cancelled or until the round is over."""

    async def publish_tags(self, asset: str, tags: Mapping[str, TagValue]) -> Collection[str]:
        """Hand on tags that have changed.

        Returns the tags that could not be handed on; they are offered again, the others are not.
        """

    async def withdraw_tags(self, asset: str, tags: Collection[str]) -> None:
        """Remove tags that are gone, and with its last tag the asset."""

    async def publish_alarm(self, asset: str | None, alarm: Mapping[str, object]) -> None:
        """Hand on what an alarm is now (the data of an ``alarm`` message of the stream).

        A publisher that has no place for alarms does nothing.
        """

    async def close(self) -> None:
        """Take leave, where there is someone to take leave of, and release everything."""


@runtime_checkable
class Certified(Protocol):
    """A publisher that shows its clients a certificate."""

    def certificate_ends_at(self) -> datetime | None:
        """When it ends; None while there is none."""


@runtime_checkable
class Keeping(Protocol):
    """A publisher whose receiver keeps tags when the service has ended."""

    @property
    def receiver(self) -> str:
        """Names the receiver, and the place there; tags are withdrawn only where they were put."""


class Endpoint(NamedTuple):
    """Where a publisher listens."""

    #: The key of the configuration with its value, as messages show it.
    key: str
    host: str
    port: int


@dataclass(frozen=True)
class PublisherEntry:
    """What the registry knows of a publisher; nothing of it but `make` imports its libraries.

    - ``name``: its name in the configuration, in logs and metrics, and of its extra.
    - ``package``: import name of the library that the extra brings; None for one that needs no
      extra.
    - ``period_s``: wall seconds between two looks for changed tags.
    - ``make``: makes it from a configuration that asks for it.
    - ``check``: checks the files and values of its section; raises `SettingsError` with one line.
    - ``listens``: where it listens, for a publisher that is a server.
    - ``warn``: one line for each thing in its section that its user should know, and that is no
      error.
    """

    name: str
    package: str | None
    period_s: float
    is_enabled: Callable[[Settings], bool]
    make: Callable[[Settings], Publisher]
    check: Callable[[Settings], None] | None = None
    listens: Callable[[Settings], Endpoint] | None = None
    warn: Callable[[Settings], Sequence[str]] | None = None
