"""Configuration models of the CAN driver."""

from pathlib import Path
from typing import Any, Literal

from pydantic import ConfigDict, Field, ValidationInfo, field_validator

from adapters.configuration import MeasuredChannel, SourceConfig


class CanSource(SourceConfig):
    """A CAN bus. Keys not named here are handed to `can.Bus` of the interface as they are.

    A relative `dbc` is taken relative to the directory given as ``context={"base_dir": ...}`` on
    validation, else to the working directory.
    """

    model_config = ConfigDict(extra="allow", frozen=True, allow_inf_nan=False)

    driver: Literal["can"] = "can"
    interface: str = Field(default="slcan", min_length=1)
    channel: str | int
    dbc: Path

    @field_validator("dbc")
    @classmethod
    def _relative_to_configuration(cls, dbc: Path, info: ValidationInfo) -> Path:
        base = (info.context or {}).get("base_dir")
        return Path(base) / dbc if base is not None else dbc

    @property
    def first_max_age_s(self) -> float:
        """A message on a bus comes in well below a second."""
        return 10.0

    @property
    def least_max_age_s(self) -> float:
        """Two seconds: no one asks for a message, and none is late for a slow answer."""
        return 2.0

    @property
    def bus_options(self) -> dict[str, Any]:
        """The keys that only python-can knows, such as ``bitrate``."""
        return dict(self.model_extra or {})


class CanChannel(MeasuredChannel):
    """Which signal of which message a channel is.

    `frame_id_mask` says which bits of the identifier must agree with the DBC's. Without it all
    must; of a J1939 message neither priority nor, where the file has one message of the group, the
    sender's address. `sentinels` are raw values, as decoded, that mean "no value". `unit` is the
    signal's, where the DBC file has none or a wrong one.
    """

    message: str
    signal: str
    frame_id_mask: int | None = Field(default=None, ge=1, le=0x1FFFFFFF)
    sentinels: tuple[float, ...] = ()
    unit: str | None = Field(default=None, min_length=1, max_length=30)
