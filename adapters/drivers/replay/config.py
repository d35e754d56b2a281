"""Configuration models of the replay driver."""

from pathlib import Path
from typing import Literal, Self

from pydantic import Field, ValidationInfo, field_validator, model_validator

from adapters.configuration import MeasuredChannel, SourceConfig

TABLES = (".csv", ".parquet", ".pq")
CAN_LOGS = (".asc", ".blf")


class ReplaySource(SourceConfig):
    """A recorded file.

    `speed` is how much faster than process time it is played, stamped with process time; 0 plays
    as fast as it can be stored, with the times of the file. A CAN log needs a `dbc`. Relative
    paths are taken relative to ``context={"base_dir": ...}`` on validation.
    """

    driver: Literal["replay"] = "replay"
    file: Path
    dbc: Path | None = None
    speed: float = Field(default=1.0, ge=0.0, le=1e6)
    repeat: bool = False

    @field_validator("file", "dbc")
    @classmethod
    def _relative_to_configuration(cls, path: Path | None, info: ValidationInfo) -> Path | None:
        base = (info.context or {}).get("base_dir")
        return Path(base) / path if base is not None and path is not None else path

    @model_validator(mode="after")
    def _kind_is_known(self) -> Self:
        if self.file.suffix.lower() not in TABLES + CAN_LOGS:
            raise ValueError(
                f"file {self.file.name!r}: expected a name that ends in "
                f"{', '.join(TABLES + CAN_LOGS)}"
            )
        if self.is_can_log and self.dbc is None:
            raise ValueError("dbc is missing: a CAN log needs the DBC file that describes it")
        if self.repeat and self.speed == 0.0:
            raise ValueError("repeat needs a speed above 0: times of the file can come only once")
        return self

    @property
    def speed_up(self) -> float:
        """As configured; at full speed the values keep the times of the file."""
        return self.speed or 1.0

    @property
    def is_can_log(self) -> bool:
        """Whether the file holds frames rather than a table."""
        return self.file.suffix.lower() in CAN_LOGS


class ReplayChannel(MeasuredChannel):
    """Where a channel is found: in a column of a table, or in a signal of a CAN message.

    In a table with the columns ``time, channel, value`` the `column` is the name of the channel.
    """

    column: str | None = None
    scale: float = 1.0
    offset: float = 0.0
    message: str | None = None
    signal: str | None = None
    frame_id_mask: int | None = Field(default=None, ge=1, le=0x1FFFFFFF)
    sentinels: tuple[float, ...] = ()
    unit: str | None = Field(default=None, min_length=1, max_length=30)

    @model_validator(mode="after")
    def _one_place(self) -> Self:
        if (self.column is None) == (self.message is None or self.signal is None):
            raise ValueError("expected either column, or message and signal")
        if self.column is not None and self.sentinels:
            raise ValueError("sentinels: expected only with message and signal")
        if self.column is not None and self.unit is not None:
            raise ValueError("unit: expected only with message and signal; a column has scale")
        return self
