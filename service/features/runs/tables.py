"""Runs and annotations in the store."""

from sqlalchemy import Index
from sqlalchemy.orm import Mapped, mapped_column

from service.store.tables import Base


class RunRow(Base):
    """A run of a machine, from its start to standstill; see `service.features.runs.runs`."""

    __tablename__ = "runs"

    asset: Mapped[str] = mapped_column(primary_key=True)
    id: Mapped[str] = mapped_column(primary_key=True)
    start_us: Mapped[int]
    end_us: Mapped[int | None]
    ended: Mapped[str]
    name: Mapped[str]
    named_by: Mapped[str]


class AnnotationRow(Base):
    """What somebody noted at a moment of an asset's history."""

    __tablename__ = "annotations"
    __table_args__ = (Index("ix_annotations_asset_time_us", "asset", "time_us"),)

    id: Mapped[str] = mapped_column(primary_key=True)
    asset: Mapped[str]
    time_us: Mapped[int]
    text: Mapped[str]
    who: Mapped[str]
