"""What the page asks for while a bench is put into service: the bodies of requests, checked."""

import re
from typing import Annotated, Final, Literal

from pydantic import AfterValidator, ConfigDict, Field, JsonValue, RootModel

from service.domain.json_values import Table
from service.domain.requests import RequestBody
from service.domain.upload_limits import SIGNALS_MAX
from service.site.page_sources import DBC_NAME

MOST_UNITS: Final = 16
MOST_REGISTERS: Final = 125
MOST_LISTEN_S: Final = 10.0
MOST_DBC_CHARACTERS: Final = 4 * 1024 * 1024
_SIGNAL: Final = re.compile(r"^[ \t]*SG_[ \t]", re.MULTILINE)

_MODBUS: Final[dict[str, JsonValue]] = {
    "name": "sensors",
    "driver": "modbus-tcp",
    "host": "192.0.2.10",
    "port": 502,
}
_CAN: Final[dict[str, JsonValue]] = {
    "name": "drive",
    "driver": "can",
    "interface": "socketcand",
    "channel": "can0",
    "host": "192.0.2.11",
    "port": 29536,
    "dbc": "drive.dbc",
}


class SourceTable(RootModel[Table]):
    """A source as in a `[[sources]]` section of the configuration file."""

    model_config = ConfigDict(json_schema_extra={"examples": [_MODBUS]})


class AssetInFile(RootModel[Table]):
    """An asset as in an `[[assets]]` section of the configuration file, with its id."""


class UnitScan(RequestBody):
    """Which units of a Modbus source are asked whether they are there."""

    model_config = ConfigDict(
        json_schema_extra={"examples": [{"source": _MODBUS, "first": 1, "count": 8}]}
    )

    source: SourceTable
    first: int = Field(1, ge=0, le=255, description="The first unit.")
    count: int = Field(8, ge=1, le=MOST_UNITS, description="How many units; one after the other.")


class RegisterRead(RequestBody):
    """Which registers are read once and shown in every type and order."""

    model_config = ConfigDict(
        json_schema_extra={
            "examples": [{"source": _MODBUS, "unit": 1, "kind": "holding", "first": 0, "count": 16}]
        }
    )

    source: SourceTable
    unit: int = Field(1, ge=0, le=255)
    kind: Literal["holding", "input"] = "holding"
    first: int = Field(0, ge=0, le=65535, description="Address of the first, as on the wire.")
    count: int = Field(16, ge=1, le=MOST_REGISTERS)


def _few_signals(text: str) -> str:
    count = sum(1 for _ in _SIGNAL.finditer(text))
    if count > SIGNALS_MAX:
        raise ValueError(f"{count} signals; expected at most {SIGNALS_MAX}")
    return text


class DbcUpload(RequestBody):
    """A DBC file; it is put beside the configuration file."""

    model_config = ConfigDict(
        json_schema_extra={"examples": [{"name": "drive.dbc", "text": 'VERSION ""\n'}]}
    )

    name: Annotated[str, Field(pattern=DBC_NAME, description="Name of the file.")]
    text: Annotated[
        str,
        Field(max_length=MOST_DBC_CHARACTERS, description="The whole file."),
        AfterValidator(_few_signals),
    ]


class SignalWatch(RequestBody):
    """Which CAN bus is listened to, and for how long."""

    model_config = ConfigDict(json_schema_extra={"examples": [{"source": _CAN, "listen_s": 2.0}]})

    source: SourceTable
    listen_s: float = Field(2.0, gt=0, le=MOST_LISTEN_S, description="Wall seconds.")


class ConfigurationChange(RequestBody):
    """Sources and assets that are made or changed; what is not named stays as it is."""

    model_config = ConfigDict(
        json_schema_extra={"examples": [{"revision": "9f86d081884c7d65", "sources": [_MODBUS]}]}
    )

    revision: str = Field(
        max_length=64, description="Of the configuration file that the change is based on."
    )
    sources: list[SourceTable] = Field(default_factory=list, max_length=100)
    assets: list[AssetInFile] = Field(default_factory=list, max_length=100)


class VersionRestored(RequestBody):
    """The configuration file that is given up for an earlier one."""

    model_config = ConfigDict(json_schema_extra={"examples": [{"revision": "9f86d081884c7d65"}]})

    revision: str = Field(max_length=64, description="Of the configuration file as it is now.")
