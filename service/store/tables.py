"""The tables. Types are those that SQLite and PostgreSQL share.

What is special to PostgreSQL, its partitions and the conditions of its indexes, stands in the
migrations alone: here it would load the dialect of PostgreSQL in every process.
"""

from datetime import datetime
from typing import Any, ClassVar

from sqlalchemy import (
    JSON,
    BigInteger,
    ColumnElement,
    DateTime,
    Dialect,
    Double,
    ForeignKey,
    Index,
    Integer,
    LargeBinary,
    MetaData,
    SmallInteger,
    String,
    TypeDecorator,
    false,
    text,
    type_coerce,
)
from sqlalchemy.orm import DeclarativeBase, InstrumentedAttribute, Mapped, mapped_column

from service.feature_folders import modules
from service.store.records import JsonDocument

#: Key of a row that the database numbers; SQLite only does so for plain INTEGER.
Serial = BigInteger().with_variant(Integer(), "sqlite")


class _Names(TypeDecorator[tuple[str, ...]]):
    """Ids of assets as one text, in which each can be found: ``,a,b,``; null for none."""

    impl = String
    cache_ok = True

    def process_bind_param(self, value: tuple[str, ...] | None, dialect: Dialect) -> str | None:
        return f",{','.join(value)}," if value else None

    def process_result_value(self, value: str | None, dialect: Dialect) -> tuple[str, ...]:
        return tuple(value.strip(",").split(",")) if value else ()


def names(column: InstrumentedAttribute[tuple[str, ...]], name: str) -> ColumnElement[bool]:
    """Whether a column of ids has this one."""
    return type_coerce(column, String).contains(f",{name},", autoescape=True)


class Base(DeclarativeBase):
    """All tables, with constraint names that migrations can rely on."""

    metadata = MetaData(
        naming_convention={
            "ix": "ix_%(table_name)s_%(column_0_N_name)s",
            "uq": "uq_%(table_name)s_%(column_0_N_name)s",
            "fk": "fk_%(table_name)s_%(column_0_N_name)s_%(referred_table_name)s",
            "pk": "pk_%(table_name)s",
        }
    )
    type_annotation_map: ClassVar[dict[Any, Any]] = {
        int: BigInteger(),
        float: Double(),
        JsonDocument: JSON(),
    }


def all_tables() -> MetaData:
    """The tables of the core, and those of all features."""
    for _ in modules("tables"):
        pass  # a module's tables are there as soon as it is loaded
    return Base.metadata


class ChannelRow(Base):
    """One channel of one asset; samples point to it by a small number."""

    __tablename__ = "channels"
    __table_args__ = (Index("uq_channels_asset_name", "asset", "name", unique=True),)

    id: Mapped[int] = mapped_column(Integer, primary_key=True)
    asset: Mapped[str]
    name: Mapped[str]


class SampleRow(Base):
    """One raw sample; a time can be sent again and is still stored once.

    The received time is unknown if an earlier version stored it.
    The channel is not compared with the table of channels, see migrations 0003 and 0005.
    """

    __tablename__ = "samples"
    __table_args__ = ({"sqlite_with_rowid": False},)

    channel_id: Mapped[int] = mapped_column(Integer, primary_key=True, autoincrement=False)
    time_us: Mapped[int] = mapped_column(primary_key=True, autoincrement=False)
    value: Mapped[float | None]
    quality: Mapped[int] = mapped_column(SmallInteger)
    received_us: Mapped[int | None]


class SampleBlockRow(Base):
    """Compressed samples of an hour of some channels, see `service.store.blocks`."""

    __tablename__ = "sample_blocks"

    id: Mapped[int] = mapped_column(Serial, primary_key=True)
    codec: Mapped[int] = mapped_column(SmallInteger)
    crc: Mapped[int]
    data: Mapped[bytes] = mapped_column(LargeBinary)


class PackedHourRow(Base):
    """An hour of a channel whose samples are in a block, and not in the table of samples."""

    __tablename__ = "packed_hours"
    __table_args__ = (
        Index("ix_packed_hours_hour_us", "hour_us"),
        Index("ix_packed_hours_block_id", "block_id"),
        {"sqlite_with_rowid": False},
    )

    channel_id: Mapped[int] = mapped_column(Integer, primary_key=True, autoincrement=False)
    hour_us: Mapped[int] = mapped_column(primary_key=True, autoincrement=False)
    block_id: Mapped[int]
    position: Mapped[int] = mapped_column(SmallInteger)
    first_us: Mapped[int]
    last_us: Mapped[int]
    sample_count: Mapped[int] = mapped_column(Integer)


class RollupRow(Base):
    """Statistics of one bucket of one channel over its good samples.

    Hours; an earlier version left seconds, minutes and ten minutes as well.
    """

    __tablename__ = "rollups"
    __table_args__ = ({"sqlite_with_rowid": False},)

    channel_id: Mapped[int] = mapped_column(Integer, ForeignKey("channels.id"), primary_key=True)
    resolution_s: Mapped[int] = mapped_column(SmallInteger, primary_key=True, autoincrement=False)
    time_us: Mapped[int] = mapped_column(primary_key=True, autoincrement=False)
    mean: Mapped[float | None]
    low: Mapped[float | None]
    high: Mapped[float | None]
    good: Mapped[int] = mapped_column(Integer)
    quality: Mapped[int] = mapped_column(SmallInteger)


class RollupBlockRow(Base):
    """Compressed minutes or seconds of a channel, see `service.store.rollup_blocks`."""

    __tablename__ = "rollup_blocks"
    __table_args__ = ({"sqlite_with_rowid": False},)

    channel_id: Mapped[int] = mapped_column(Integer, primary_key=True, autoincrement=False)
    resolution_s: Mapped[int] = mapped_column(SmallInteger, primary_key=True, autoincrement=False)
    begin_us: Mapped[int] = mapped_column(primary_key=True, autoincrement=False)
    codec: Mapped[int] = mapped_column(SmallInteger)
    crc: Mapped[int]
    data: Mapped[bytes] = mapped_column(LargeBinary)


class StaleRollupRow(Base):
    """An hour of a channel whose rollups are not, or not yet again, those of its samples."""

    __tablename__ = "stale_rollups"
    __table_args__ = ({"sqlite_with_rowid": False},)

    channel_id: Mapped[int] = mapped_column(Integer, ForeignKey("channels.id"), primary_key=True)
    hour_us: Mapped[int] = mapped_column(primary_key=True, autoincrement=False)


class RawHorizonRow(Base):
    """The time before which raw samples are not kept any more; one row, or none."""

    __tablename__ = "raw_horizon"

    id: Mapped[int] = mapped_column(Integer, primary_key=True)
    time_us: Mapped[int]


class RetentionMarkRow(Base):
    """The time from which retention counts its days back, of the process and of the wall clock."""

    __tablename__ = "retention_marks"

    clock: Mapped[str] = mapped_column(primary_key=True)
    time_us: Mapped[int]


class ModelVersionRow(Base):
    """One model of one asset; at most one is active."""

    __tablename__ = "model_versions"
    __table_args__ = (
        Index(
            "uq_model_versions_active",
            "asset",
            unique=True,
            sqlite_where=text("status = 'active'"),
        ),
    )

    asset: Mapped[str] = mapped_column(primary_key=True)
    version: Mapped[int] = mapped_column(primary_key=True, autoincrement=False)
    status: Mapped[str]
    reason: Mapped[str]
    created_at_us: Mapped[int]
    document: Mapped[JsonDocument]


class ActivationRow(Base):
    """Journal of the active model: one line per change."""

    __tablename__ = "model_activations"
    __table_args__ = (Index("ix_model_activations_asset_id", "asset", "id"),)

    id: Mapped[int] = mapped_column(Serial, primary_key=True)
    asset: Mapped[str]
    version: Mapped[int]
    at_us: Mapped[int]
    who: Mapped[str]
    comment: Mapped[str]


class JobRow(Base):
    """One identification job; at most one per asset is queued or running."""

    __tablename__ = "jobs"
    __table_args__ = (
        Index(
            "uq_jobs_unfinished",
            "asset",
            unique=True,
            sqlite_where=text("status IN ('queued', 'running')"),
        ),
        Index("uq_jobs_asset_idempotency_key", "asset", "idempotency_key", unique=True),
    )

    id: Mapped[str] = mapped_column(primary_key=True)
    asset: Mapped[str]
    status: Mapped[str]
    progress: Mapped[float]
    best_fitness: Mapped[float | None]
    evaluations: Mapped[int]
    created_at_us: Mapped[int]
    started_at_us: Mapped[int | None]
    ended_at_us: Mapped[int | None]
    error: Mapped[str | None]
    model_version: Mapped[int | None]
    request: Mapped[JsonDocument]
    idempotency_key: Mapped[str | None]
    attempts: Mapped[int]


class SisterRecordRow(Base):
    """What a machine teaches its sisters; see `service.store.sister_records`."""

    __tablename__ = "sister_records"
    __table_args__ = (Index("ix_sister_records_family", "family"),)

    asset: Mapped[str] = mapped_column(primary_key=True)
    family: Mapped[str]
    machine: Mapped[JsonDocument]
    until_us: Mapped[int]
    minutes: Mapped[int]
    load_n_max: Mapped[float]
    speed_rpm_max: Mapped[float]
    document: Mapped[JsonDocument]


class AssetStateRow(Base):
    """What the live twin of an asset needs to go on after a restart."""

    __tablename__ = "asset_states"

    asset: Mapped[str] = mapped_column(primary_key=True)
    document: Mapped[JsonDocument]


class AlarmRow(Base):
    """One life cycle of an alarm; of one (asset, kind, channel, level) at most one is not over."""

    __tablename__ = "alarms"
    __table_args__ = (
        Index(
            "uq_alarms_open",
            "asset",
            "kind",
            "channel",
            "level",
            unique=True,
            sqlite_where=text("state <> 'NORM'"),
        ),
    )

    id: Mapped[str] = mapped_column(primary_key=True)
    asset: Mapped[str]
    kind: Mapped[str]
    channel: Mapped[str]
    level: Mapped[str]
    state: Mapped[str]
    priority: Mapped[int] = mapped_column(SmallInteger)
    message: Mapped[str]
    predicted: Mapped[bool]
    raised_at_us: Mapped[int]
    since_us: Mapped[int]
    returned_at_us: Mapped[int | None]
    acknowledged_at_us: Mapped[int | None]
    acknowledged_by: Mapped[str | None]
    value: Mapped[float | None]
    limit_value: Mapped[float | None]
    unit: Mapped[str | None]
    lead_time_s: Mapped[float | None]
    probability: Mapped[float | None]
    present: Mapped[bool] = mapped_column(server_default=false())
    latched: Mapped[bool] = mapped_column(server_default=false())
    shelved_until_us: Mapped[int | None]
    shelved_by: Mapped[str | None]
    suppressed_reason: Mapped[str | None]
    comment: Mapped[str | None]
    peak_value: Mapped[float | None]
    peak_at_us: Mapped[int | None]
    assets: Mapped[tuple[str, ...]] = mapped_column(_Names, nullable=True)


class AlarmTransitionRow(Base):
    """Journal of the alarms: one line per change of state or comment, and events without alarm."""

    __tablename__ = "alarm_journal"
    __table_args__ = (
        Index("ix_alarm_journal_time_us", "time_us"),
        Index("ix_alarm_journal_alarm_id", "alarm_id"),
    )

    id: Mapped[int] = mapped_column(Serial, primary_key=True)
    alarm_id: Mapped[str | None] = mapped_column(ForeignKey("alarms.id"))
    asset: Mapped[str]
    kind: Mapped[str]
    channel: Mapped[str]
    level: Mapped[str]
    time_us: Mapped[int]
    from_state: Mapped[str]
    to_state: Mapped[str]
    who: Mapped[str]
    comment: Mapped[str]
    value: Mapped[float | None]
    message: Mapped[str]
    event: Mapped[str]
    priority: Mapped[int | None] = mapped_column(SmallInteger)
    until_us: Mapped[int | None]
    peak_value: Mapped[float | None]
    peak_at_us: Mapped[int | None]
    duration_s: Mapped[float | None]
    assets: Mapped[tuple[str, ...]] = mapped_column(_Names, nullable=True)


class DeliveryRow(Base):
    """The latest change that a run of a service had delivered; see `service.store.outbox`."""

    __tablename__ = "deliveries"

    sender: Mapped[str] = mapped_column(primary_key=True)
    number: Mapped[int]


class RefusedChangeRow(Base):
    """A change that the store did not take; see `service.store.refused_changes`."""

    __tablename__ = "refused_changes"

    id: Mapped[int] = mapped_column(Serial, primary_key=True)
    time_us: Mapped[int]
    sender: Mapped[str]
    assets: Mapped[str]
    summary: Mapped[str]
    reason: Mapped[str]
    document: Mapped[str]


class AlarmSettingRow(Base):
    """A change of an alarm's settings; see `service.store.alarm_overlays`."""

    __tablename__ = "alarm_settings"
    __table_args__ = (
        Index("ix_alarm_settings_revision", "revision"),
        Index("ix_alarm_settings_asset", "asset"),
    )

    id: Mapped[int] = mapped_column(Serial, primary_key=True)
    revision: Mapped[int]
    asset: Mapped[str]
    kind: Mapped[str]
    channel: Mapped[str]
    level: Mapped[str]
    before: Mapped[JsonDocument]
    after: Mapped[JsonDocument]
    who: Mapped[str]
    at_us: Mapped[int]
    comment: Mapped[str]


class CellRow(Base):
    """A cell of a fleet that runs, or died a moment ago; see `service.store.ownership`."""

    __tablename__ = "cells"

    id: Mapped[str] = mapped_column(primary_key=True)
    beat_at: Mapped[datetime] = mapped_column(DateTime(timezone=True))
    #: Of the assets that it has taken up.
    assets_revision: Mapped[int]


class PartitionRow(Base):
    """A part of a fleet's assets; each new owner counts its epoch up. Empty owner: none."""

    __tablename__ = "partitions"

    id: Mapped[int] = mapped_column(Integer, primary_key=True, autoincrement=False)
    epoch: Mapped[int]
    owner: Mapped[str]


class ProvisionedAssetRow(Base):
    """The table of an asset that is not in the configuration file, as JSON; None: removed.

    Removed: when it was removed the last time. Added: when it was added again after that.
    """

    __tablename__ = "provisioned_assets"
    __table_args__ = (Index("ix_provisioned_assets_revision", "revision"),)

    id: Mapped[str] = mapped_column(primary_key=True)
    document: Mapped[str | None]
    revision: Mapped[int]
    changed_us: Mapped[int]
    removed_us: Mapped[int | None]
    added_us: Mapped[int | None]


class StoreIdentityRow(Base):
    """Which store this is; one row, another after each restore, see `service.store.identity`."""

    __tablename__ = "store_identity"

    id: Mapped[int] = mapped_column(SmallInteger, primary_key=True, autoincrement=False)
    incarnation: Mapped[str]
    origin: Mapped[str]
    since_us: Mapped[int]
