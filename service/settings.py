"""The configuration file: one TOML document, checked before anything starts.

Every setting can also come from the environment as ``BEARING_TWIN__SECTION__KEY`` (arrays as JSON
text), which wins over the file. Errors name the key, the value and what was expected.
"""

import re
import tomllib
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    PositiveFloat,
    ValidationError,
    model_validator,
)
from pydantic_settings import (
    BaseSettings,
    EnvSettingsSource,
    PydanticBaseSettingsSource,
    SettingsConfigDict,
)

SENSOR_CHANNELS = ("speed_rpm", "load_n", "ambient_c", "t_inner_ring_c", "t_outer_ring_c")
_CHANNEL_NAME = re.compile(
    r"(speed_rpm|load_n|ambient_c|t_inner_ring_c|t_outer_ring_c|t_node_([1-9]|1[0-3])_c)"
)
LIMITED_CHANNELS = ("t_inner_ring_c", "t_outer_ring_c")


class SettingsError(ValueError):
    """A configuration that cannot be used; its text is one line for the user."""


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class ServiceSection(_Section):
    """Where the service listens and keeps its data."""

    host: str = "127.0.0.1"
    port: int = Field(8080, ge=0, le=65535)
    data_dir: Path = Path("var")
    database_url: str = ""
    #: Disk that samples may take while they wait for a store that is away.
    spool_mib: int = Field(512, ge=1)


class ClockSection(_Section):
    """Process seconds per wall second; above 1 only with the virtual bench."""

    rate: float = Field(1.0, gt=0, le=3600)


class LowRisk(_Section):
    """The region of speed and load whose data may be used for identification."""

    speed_rpm_max: PositiveFloat
    load_n_max: PositiveFloat


class Limits(_Section):
    """Warning and alarm temperature of one measured point, in degrees Celsius."""

    warning: float = Field(ge=-50, le=500)
    alarm: float = Field(ge=-50, le=500)

    @model_validator(mode="after")
    def _warning_comes_first(self) -> Self:
        if self.warning >= self.alarm:
            raise ValueError(
                f"warning {self.warning:g} must be below alarm {self.alarm:g} (degrees Celsius)"
            )
        return self


class IdentificationSection(_Section):
    """How far the twin may go by itself: observe, suggest or apply (activate)."""

    ladder: Literal["observe", "suggest", "apply"] = "apply"


class ControllerSection(_Section):
    """Channels of the bench controller; each is checked by the driver of its source."""

    phase: dict[str, Any] | None = None
    speed_setpoint_rpm: dict[str, Any] | None = None
    load_setpoint_n: dict[str, Any] | None = None
    plan: dict[str, Any] | None = None


def _channel_name(name: str) -> str:
    if not _CHANNEL_NAME.fullmatch(name):
        raise ValueError(
            f"unknown channel; expected one of {', '.join(SENSOR_CHANNELS)}, "
            "t_node_1_c to t_node_13_c"
        )
    return name


def _limited(name: str) -> str:
    if name not in LIMITED_CHANNELS and not re.fullmatch(r"t_node_([1-9]|1[0-3])_c", name):
        raise ValueError("limits belong to a temperature such as t_inner_ring_c")
    return name


class AssetSection(_Section):
    """One bearing on a bench or in a motor."""

    id: str = Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]{0,63}$")
    bearing: str
    network: Literal["bearing-14"] = "bearing-14"
    model: Literal["default", "paper"] = "default"
    low_risk: LowRisk
    limits: dict[Annotated[str, AfterValidator(_limited)], Limits] = {
        "t_inner_ring_c": Limits(warning=90, alarm=105),
        "t_outer_ring_c": Limits(warning=80, alarm=95),
    }
    channels: dict[Annotated[str, AfterValidator(_channel_name)], dict[str, Any]]
    controller: ControllerSection = ControllerSection()
    identification: IdentificationSection = IdentificationSection()


class SecuritySection(_Section):
    """Who may read the metrics without a key (loopback always may)."""

    allow_unauthenticated_metrics: bool = False


class Settings(BaseSettings):
    """The whole configuration of a service."""

    model_config = SettingsConfigDict(
        env_prefix="BEARING_TWIN__", env_nested_delimiter="__", extra="forbid", frozen=True
    )

    service: ServiceSection = ServiceSection()
    clock: ClockSection = ClockSection()
    security: SecuritySection = SecuritySection()
    sources: tuple[dict[str, Any], ...] = ()
    assets: tuple[AssetSection, ...] = ()
    base_dir: Path = Field(Path(), exclude=True)

    @classmethod
    def settings_customise_sources(
        cls,
        settings_cls: type[BaseSettings],
        init_settings: PydanticBaseSettingsSource,
        env_settings: PydanticBaseSettingsSource,
        dotenv_settings: PydanticBaseSettingsSource,
        file_secret_settings: PydanticBaseSettingsSource,
    ) -> tuple[PydanticBaseSettingsSource, ...]:
        """Let the environment win over the file."""
        return EnvSettingsSource(settings_cls), init_settings

    @model_validator(mode="after")
    def _names_are_unique(self) -> Self:
        for what, names in (
            ("sources", [str(source.get("name")) for source in self.sources]),
            ("assets", [asset.id for asset in self.assets]),
        ):
            for name in names:
                if names.count(name) > 1:
                    raise ValueError(f"{what}: the name {name!r} is used twice; expected unique")
        return self

    def path(self, relative: Path | str) -> Path:
        """Resolve a path of the configuration against the directory of its file."""
        return self.base_dir / relative

    @property
    def data_dir(self) -> Path:
        """Directory of the store, the spool and checkpoints."""
        return self.path(self.service.data_dir)


def describe(error: ValidationError, prefix: str = "") -> str:
    """Say in one line which key of a configuration is wrong, its value and what was expected."""
    first = error.errors()[0]
    key = prefix
    for part in first["loc"]:
        if part == "[key]":
            continue
        key += f"[{part}]" if isinstance(part, int) else f"{'.' if key else ''}{part}"
    message = first["msg"].removeprefix("Value error, ")
    given = first.get("input")
    shown = "" if isinstance(given, dict | list | BaseModel) else f" = {given!r}"
    if first["type"] == "missing":
        shown, message = "", "missing; expected a value"
    if first["type"] == "extra_forbidden":
        message = "unknown key"
    more = f" (and {error.error_count() - 1} more)" if error.error_count() > 1 else ""
    return f"{key}{shown}: {message}{more}" if key else f"{message}{more}"


def load_settings(file: Path | None) -> Settings:
    """Read a configuration file and the environment.

    Parameters
    ----------
    file : pathlib.Path or None
        TOML file; None takes the defaults, relative to the present directory.

    Raises
    ------
    SettingsError
        If the file cannot be read or a key is wrong; one line that names the key.
    """
    document: dict[str, Any] = {}
    base_dir = Path()
    if file is not None:
        try:
            document = tomllib.loads(file.read_text(encoding="utf-8"))
        except OSError as error:
            raise SettingsError(f"{file}: cannot be read ({error.strerror})") from error
        except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
            raise SettingsError(f"{file}: not valid TOML ({error})") from error
        base_dir = file.parent
    where = f"{file}: " if file else ""
    try:
        return Settings(**document, base_dir=base_dir)
    except ValidationError as error:
        raise SettingsError(where + describe(error)) from error
    except TypeError as error:
        raise SettingsError(f"{where}{error}") from error
