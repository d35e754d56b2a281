"""The store: samples, models, jobs, alarms, keys, in SQLite or PostgreSQL."""

from service.store.alarm_overlays import AlarmSettingChange, AlarmSettingPage
from service.store.alarm_records import (
    Alarm,
    AlarmCount,
    AlarmJournalPage,
    AlarmTransition,
    Annunciations,
    JournalFilter,
)
from service.store.changes import AlarmChange, FeatureChange, RefuseChange
from service.store.durable_queue import DurableQueue
from service.store.errors import (
    ActiveJobError,
    DatabaseInUseError,
    DataDirectoryInUseError,
    NotOwnerError,
    StoreDamagedError,
    StoreError,
    StoreUnavailableError,
)
from service.store.locking import DataDirectoryLock, lock_data_directory
from service.store.opening import lock_database
from service.store.outbox import Outbox
from service.store.pages import PageRow
from service.store.queue_file import (
    Mended,
    QueueFile,
    QueueLayout,
    QueueUnavailableError,
    Row,
)
from service.store.records import (
    Activation,
    ApiKey,
    AuditEntry,
    AuditPage,
    BrowserSession,
    FirstModel,
    Job,
    JobChanges,
    MinuteTable,
    ModelStatus,
    ModelVersion,
    ProvisionedAsset,
    Rollup,
    StoredSample,
    WriteCounts,
)
from service.store.rollups import Retention, RetentionTime
from service.store.store import Store

__all__ = [
    "Activation",
    "ActiveJobError",
    "Alarm",
    "AlarmChange",
    "AlarmCount",
    "AlarmJournalPage",
    "AlarmSettingChange",
    "AlarmSettingPage",
    "AlarmTransition",
    "Annunciations",
    "ApiKey",
    "AuditEntry",
    "AuditPage",
    "BrowserSession",
    "DataDirectoryInUseError",
    "DataDirectoryLock",
    "DatabaseInUseError",
    "DurableQueue",
    "FeatureChange",
    "FirstModel",
    "Job",
    "JobChanges",
    "JournalFilter",
    "Mended",
    "MinuteTable",
    "ModelStatus",
    "ModelVersion",
    "NotOwnerError",
    "Outbox",
    "PageRow",
    "ProvisionedAsset",
    "QueueFile",
    "QueueLayout",
    "QueueUnavailableError",
    "RefuseChange",
    "Retention",
    "RetentionTime",
    "Rollup",
    "Row",
    "Store",
    "StoreDamagedError",
    "StoreError",
    "StoreUnavailableError",
    "StoredSample",
    "WriteCounts",
    "lock_data_directory",
    "lock_database",
]
