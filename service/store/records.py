"""What the store hands out and takes in: plain typed records, never live database rows.

All times are UTC microseconds since the epoch: process time, but for keys, sessions and the audit
trail, which go by the wall clock.
"""

from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, TypedDict

import numpy as np
from numpy.typing import NDArray

from service.domain.job_states import JobStatus
from service.domain.roles import Role

ModelStatus = Literal["candidate", "active", "retired", "rejected"]

JsonDocument = dict[str, Any]


class WriteCounts(NamedTuple):
    """What became of a batch of samples: newly stored (or mended) and already known.

    The others of the batch are older than the raw samples that are kept, and are not stored.
    """

    stored: int
    duplicates: int


class StoredSample(NamedTuple):
    """One raw sample; the value is None when there is none (bad quality).

    ``received_us`` is when the service received it; None if an earlier version stored it.
    """

    channel: str
    time_us: int
    value: float | None
    quality: int
    received_us: int | None


class Rollup(NamedTuple):
    """One bucket of one channel: statistics over its good samples.

    ``time_us`` is the start of the bucket. ``good`` is the number of good samples; without any,
    the statistics are None and ``quality`` is the worst quality in the bucket.
    """

    channel: str
    time_us: int
    mean: float | None
    min: float | None
    max: float | None
    good: int
    quality: int


@dataclass(frozen=True, slots=True)
class MinuteTable:
    """Averages per minute of several channels, for the minutes that have any sample at all.

    - ``minute_us``: (n,) start of each minute, ascending.
    - ``mean``: (n,) mean of the good samples per channel, NaN where a minute has none.
    - ``good_count``, ``bad_count``: (n,) samples of good quality, and of any other quality, per
      channel.
    """

    minute_us: NDArray[np.int64]
    mean: dict[str, NDArray[np.float64]]
    good_count: dict[str, NDArray[np.int64]]
    bad_count: dict[str, NDArray[np.int64]]


@dataclass(frozen=True, slots=True)
class ModelVersion:
    """One immutable model of an asset; only its status and the reason for it ever change."""

    asset: str
    version: int
    status: ModelStatus
    reason: str
    created_at_us: int
    document: JsonDocument


@dataclass(frozen=True, slots=True)
class FirstModel:
    """A model that an asset begins with, and what the journal says of it."""

    document: JsonDocument
    comment: str


@dataclass(frozen=True, slots=True)
class Activation:
    """One line of the activation journal: who made a version the active one, when and why."""

    asset: str
    version: int
    at_us: int
    who: str
    comment: str


@dataclass(frozen=True, slots=True)
class Job:
    """One identification job."""

    id: str
    asset: str
    status: JobStatus
    progress: float
    best_fitness: float | None
    evaluations: int
    created_at_us: int
    started_at_us: int | None
    ended_at_us: int | None
    error: str | None
    model_version: int | None
    request: JsonDocument
    idempotency_key: str | None
    attempts: int


class JobChanges(TypedDict, total=False):
    """The fields of a job that may change."""

    status: JobStatus
    progress: float
    best_fitness: float | None
    evaluations: int
    started_at_us: int | None
    ended_at_us: int | None
    error: str | None
    model_version: int | None
    attempts: int


@dataclass(frozen=True, slots=True)
class ProvisionedAsset:
    """An asset that is not in the configuration file (changed at, on the wall clock).

    - ``table``: as a configuration file would hold it, without its id; None when it was removed.
    - ``revision``: of its last change.
    - ``removed_us``: when it was removed the last time; None: never.
    - ``added_us``: when it was added again after that; None: not since.
    """

    id: str
    table: dict[str, Any] | None
    revision: int
    changed_us: int
    removed_us: int | None = None
    added_us: int | None = None


@dataclass(frozen=True, slots=True)
class ApiKey:
    """An API key as the store knows it: never the key itself (times on the wall clock)."""

    id: str
    prefix: str
    role: Role
    label: str
    created_us: int
    expires_us: int | None
    revoked_us: int | None

    def is_valid(self, now_us: int) -> bool:
        """Whether the key opens anything at this wall time (UTC microseconds)."""
        return self.revoked_us is None and (self.expires_us is None or now_us < self.expires_us)


@dataclass(frozen=True, slots=True)
class BrowserSession:
    """A browser that logged in with a key; it lives no longer than that key."""

    id: str
    key: ApiKey
    created_us: int
    expires_us: int

    def is_valid(self, now_us: int) -> bool:
        """Whether the session opens anything at this wall time (UTC microseconds)."""
        return now_us < self.expires_us and self.key.is_valid(now_us)


@dataclass(frozen=True, slots=True)
class AuditEntry:
    """One line of the audit trail: who did what to what, when (wall clock) and from where."""

    time_us: int
    who: str
    address: str
    action: str
    target: str = ""
    detail: str = ""


@dataclass(frozen=True, slots=True)
class AuditPage:
    """Part of the audit trail, newest first; ``next_cursor`` is None on the last page."""

    items: list[AuditEntry]
    next_cursor: int | None
