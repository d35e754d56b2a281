"""Configuration models of the OPC UA driver, and what is checked before anything starts."""

import ipaddress
import os
import re
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Literal, Self
from urllib.parse import urlsplit

from pydantic import AfterValidator, Field, ValidationInfo, field_validator, model_validator

from adapters.configuration import ConfigurationError, MeasuredChannel, SourceConfig
from adapters.protocol import ChannelBinding, PlanBinding


def _endpoint(endpoint: str) -> str:
    place = urlsplit(endpoint)
    try:
        port = place.port
    except ValueError:
        port = 0
    if place.scheme != "opc.tcp" or not place.hostname or port == 0:
        raise ValueError("expected opc.tcp://HOST:PORT, with a path if the server has one")
    if place.username or place.password:
        raise ValueError("expected no user in the address: use user and password_variable")
    return endpoint


class OpcUaSource(SourceConfig):
    """An OPC UA server whose values are subscribed to. Times are wall time.

    Outside this machine the connection is encrypted, and the server known by its certificate.
    `backfill_max_s` is the longest span behind a loss that is fetched from the server's history.
    """

    driver: Literal["opcua"] = "opcua"
    endpoint: Annotated[str, AfterValidator(_endpoint)]
    sampling_interval_s: float = Field(default=0.5, ge=0.01, le=3600.0)
    timeout_s: float = Field(default=4.0, ge=0.2, le=60.0)
    security_policy: Literal["None", "Basic256Sha256"] = "None"
    server_certificate: Path | None = None
    certificate: Path | None = None
    private_key: Path | None = None
    user: str | None = Field(default=None, min_length=1)
    password_variable: str | None = Field(default=None, min_length=1)
    backfill: bool = True
    backfill_max_s: float = Field(default=86400.0, gt=0.0, le=31 * 86400.0)

    @field_validator("server_certificate", "certificate", "private_key")
    @classmethod
    def _relative_to_configuration(cls, path: Path | None, info: ValidationInfo) -> Path | None:
        base = (info.context or {}).get("base_dir")
        return Path(base) / path if path is not None and base is not None else path

    @model_validator(mode="after")
    def _is_secure(self) -> Self:
        encrypted = self.security_policy != "None"
        files = {
            "server_certificate": self.server_certificate,
            "certificate": self.certificate,
            "private_key": self.private_key,
        }
        missing = [name for name, path in files.items() if path is None]
        if encrypted and missing:
            raise ValueError(
                f"security_policy {self.security_policy!r} needs {', '.join(missing)} (a file)"
            )
        if not encrypted and len(missing) < len(files):
            raise ValueError('certificates need security_policy = "Basic256Sha256"')
        if not encrypted and not _is_loopback(urlsplit(self.endpoint).hostname or ""):
            raise ValueError(
                f"endpoint {self.endpoint} is outside this machine: expected "
                'security_policy = "Basic256Sha256" with server_certificate'
            )
        if (self.user is None) != (self.password_variable is None):
            raise ValueError(
                "expected user and password_variable (environment variable with the password) "
                "together"
            )
        return self


class OpcUaChannel(MeasuredChannel):
    """Which node a channel is: ``ns=2;s=NAME``, or ``nsu=URI;s=NAME``, which survives a new order.

    value = value of the node * scale + offset.
    """

    node: str
    scale: float = 1.0
    offset: float = 0.0

    @field_validator("node")
    @classmethod
    def _is_node_id(cls, node: str) -> str:
        if not re.fullmatch(r"(ns=\d+;|nsu=[^;]+;)?(i=\d+|[sgb]=.+)", node):
            raise ValueError("expected a node id: ns=2;s=NAME, nsu=URI;s=NAME or ns=2;i=NUMBER")
        return node

    @field_validator("scale")
    @classmethod
    def _scale_is_not_zero(cls, scale: float) -> float:
        if scale == 0.0:
            raise ValueError("scale must not be 0")
        return scale


def check(
    source: OpcUaSource, channels: Sequence[ChannelBinding], plans: Sequence[PlanBinding]
) -> None:
    """Check an OPC UA source with everything bound to it; opens no connection.

    Raises `ConfigurationError`, also without asyncua, and for a plan.
    """
    if find_spec("asyncua") is None:
        raise ConfigurationError(
            f"source {source.name!r}: driver 'opcua' needs the package asyncua; "
            "install bearing-twin[opcua]"
        )
    if plans:
        raise ConfigurationError(
            f"plan of {plans[0].asset}: source {source.name!r} is an OPC UA server, "
            "a plan needs a Modbus source"
        )
    for path in (source.server_certificate, source.certificate, source.private_key):
        if path is None:
            continue
        try:
            with path.open("rb"):
                pass
        except OSError as error:
            raise ConfigurationError(
                f"source {source.name!r}: file {str(path)!r} cannot be read: {error.strerror}"
            ) from None
    variable = source.password_variable
    if variable is not None and not os.environ.get(variable):
        raise ConfigurationError(
            f"source {source.name!r}: environment variable {variable!r} (password_variable) "
            "is not set"
        )


def _is_loopback(host: str) -> bool:
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False
