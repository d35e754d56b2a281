"""The configuration file: one TOML document, checked before anything starts.

Every setting can also come from the environment as ``BEARING_TWIN__SECTION__KEY`` (arrays as JSON
text), which wins over the file. Errors name the key, the value and what was expected.
"""

import ipaddress
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Final, Literal, Self
from urllib.parse import urlsplit

from pydantic import (
    AfterValidator,
    BeforeValidator,
    Field,
    PositiveFloat,
    SecretStr,
    ValidationError,
    ValidationInfo,
    field_validator,
    model_validator,
)
from pydantic_core import PydanticCustomError
from pydantic_settings import (
    BaseSettings,
    EnvSettingsSource,
    PydanticBaseSettingsSource,
    SettingsConfigDict,
)
from pydantic_settings import SettingsError as UnreadableVariableError

from service.alarm_kinds import AlarmsSection, above_ambient
from service.domain.channels import AMBIENT, NODES, OPERATING_CHANNELS, RING_SENSORS, STANDARD
from service.domain.section import Section
from service.site.configuration import SettingsError, TomlTable, describe_all, read_toml
from service.site.machines.bearings import BearingSection, bearing_table, with_designation
from service.site.machines.networks import (
    BEARING_14,
    NetworkSection,
    folder_of_files,
    network_table,
)
from service.site.templates import from_template, templates_by_name
from twin_core.windows import LowRiskRegion


def _network(text: str) -> str:
    try:
        ipaddress.ip_network(text)
    except ValueError:
        raise ValueError(
            "expected an address such as 127.0.0.1, or a network such as 10.0.0.0/24"
        ) from None
    return text


class ServiceSection(Section):
    """Where the service listens and keeps its data."""

    host: str = "127.0.0.1"
    port: int = Field(8080, ge=0, le=65535)
    data_dir: Path = Path("var")
    #: Addresses and networks whose X-Forwarded-For and X-Forwarded-Proto are believed.
    trusted_proxies: tuple[Annotated[str, AfterValidator(_network)], ...] = ()
    database_url: str = Field("", repr=False)  # it may hold a password
    #: Disk that samples may take while they wait for a store that is away.
    spool_mib: int = Field(512, ge=1)


def _kept_a_year(days: float) -> float:
    # The database itself refuses to give up younger lines, by a clock of its own: a day more.
    if 0 < days < _LEAST_AUDIT_DAYS:
        raise ValueError(f"expected 0 (without limit) or at least {_LEAST_AUDIT_DAYS} days")
    return days


Days = Annotated[float, Field(gt=0, le=100_000)]
_LEAST_AUDIT_DAYS = 366
_TEN_YEARS_DAYS = 3652


class RetentionSection(Section):
    """Days for which history is kept at each resolution, None for no limit.

    Journal of the alarms (process time) and audit trail (wall clock): with 0 without limit.
    """

    raw_days: Days | None = None
    second_days: Days | None = None
    minute_days: Days | None = None
    hour_days: Days | None = None
    journal_days: float = Field(_TEN_YEARS_DAYS, ge=0, le=100_000)
    audit_days: Annotated[float, AfterValidator(_kept_a_year)] = Field(
        _TEN_YEARS_DAYS, ge=0, le=100_000
    )


class ClockSection(Section):
    """Process seconds per wall second; above 1 only with the virtual bench."""

    rate: float = Field(1.0, gt=0, le=3600)


class LowRisk(Section):
    """The region of speed and load whose data may be used for identification."""

    speed_rpm_max: PositiveFloat
    load_n_max: PositiveFloat

    @property
    def region(self) -> LowRiskRegion:
        """The same for the twin."""
        return LowRiskRegion(self.speed_rpm_max, self.load_n_max)


class Limits(Section):
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


class IdentificationSection(Section):
    """How far the twin may go by itself: observe, suggest or apply (activate)."""

    ladder: Literal["observe", "suggest", "apply"] = "apply"


class VerdictSection(Section):
    """When the next step is called safe."""

    #: Below this probability of exceeding a warning limit within the step.
    safe_below_probability: float = Field(0.05, gt=0, le=0.5)


class ControllerSection(Section):
    """Channels of the bench controller; each is checked by the driver of its source."""

    phase: TomlTable | None = None
    speed_setpoint_rpm: TomlTable | None = None
    load_setpoint_n: TomlTable | None = None
    plan: TomlTable | None = None


def _channel_name(name: str, info: ValidationInfo) -> str:
    known = _temperatures(info)
    if known is not None and name not in (*OPERATING_CHANNELS, *_inputs(info), *known):
        raise ValueError(f"unknown channel; expected one of {_listed(info)}")
    return name


def _limited(name: str, info: ValidationInfo) -> str:
    known = _temperatures(info)
    if known is not None and name not in known:
        raise ValueError(f"limits belong to a temperature such as {known[0]}")
    return name


def _temperatures(info: ValidationInfo) -> tuple[str, ...] | None:
    """What may be measured on an asset; None with a network that has an error of its own."""
    if "network" not in info.data:
        return None
    network = _network_of(info)
    return RING_SENSORS + NODES if network is None else network.temperature_names


def _inputs(info: ValidationInfo) -> tuple[str, ...]:
    network = _network_of(info)
    return () if network is None else tuple(network.inputs)


def _listed(info: ValidationInfo) -> str:
    if _network_of(info) is None:
        return f"{', '.join(OPERATING_CHANNELS + RING_SENSORS)}, {NODES[0]} to {NODES[-1]}"
    return ", ".join((*OPERATING_CHANNELS, *_inputs(info), *(_temperatures(info) or ())))


def _network_of(info: ValidationInfo) -> NetworkSection | None:
    """The network of the asset that is being read."""
    network: NetworkSection | None = info.data.get("network")
    return network


_RING_LIMITS = {
    one.name: dict(zip(("warning", "alarm"), one.limits_c, strict=True))
    for one in STANDARD
    if one.limits_c is not None
}


ModelName = Literal["default", "paper", "paper-reduced"]
"""Models of a bearing; see `twin_core.models`."""


#: Pattern of the id of an asset.
ASSET_ID: Final = r"^[A-Za-z0-9][A-Za-z0-9._-]{0,63}$"


class AssetSection(Section):
    """One bearing on a bench or in a motor."""

    id: str = Field(pattern=ASSET_ID)
    #: What it was made from, if anything; its tables are the template's with what it gives itself.
    template: str = Field("", max_length=64)
    #: What the pages call the asset; its id if absent.
    name: str = Field("", max_length=64)
    #: Assets of one group can be looked at together in the fleet view.
    group: str = Field("", max_length=64)
    network: Annotated[NetworkSection | None, BeforeValidator(network_table)] = None
    bearing: Annotated[BearingSection, BeforeValidator(bearing_table)] | None = Field(
        None, validate_default=True
    )
    model: ModelName = "default"
    low_risk: LowRisk
    limits: dict[Annotated[str, AfterValidator(_limited)], Limits] = Field(default_factory=dict)
    channels: dict[Annotated[str, AfterValidator(_channel_name)], TomlTable]
    controller: ControllerSection = ControllerSection()
    identification: IdentificationSection = IdentificationSection()
    alarms: AlarmsSection = AlarmsSection()
    verdict: VerdictSection = VerdictSection()

    @model_validator(mode="before")
    @classmethod
    def _limit_the_rings(cls, given: Any) -> Any:
        """A bearing has usual limits; what a network of one's own bears only its user knows."""
        if isinstance(given, dict) and given.get("network") in (None, BEARING_14):
            return {"limits": _RING_LIMITS} | given
        return given

    @field_validator("bearing")
    @classmethod
    def _bearing_or_network(
        cls, bearing: BearingSection | None, info: ValidationInfo
    ) -> BearingSection | None:
        # A network that is wrong is not in the data: its own error says so.
        network = info.data.get("network", ...)
        if bearing is None and network is None:
            raise PydanticCustomError("missing", "Field required")
        if bearing is not None and network not in (None, ...):
            raise ValueError(
                "expected no bearing together with a network of your own, or no network"
            )
        return bearing

    @model_validator(mode="after")
    def _above_ambient_is_measured(self) -> Self:
        where = "alarms.above_ambient.limits"
        limits = self.alarms.rule(above_ambient.KIND).limits
        for name in limits:
            if not (name.startswith("t_") and name in self.channels):
                raise ValueError(f"{where}.{name}: expected a temperature among the channels")
        if limits and AMBIENT not in self.channels:
            raise ValueError(f"{where}: the channel ambient_c is missing; expected it too")
        return self

    @property
    def network_name(self) -> str:
        """Name of the asset's network."""
        return BEARING_14 if self.network is None else self.network.name

    @property
    def input_names(self) -> tuple[str, ...]:
        """Channels that the asset's network asks for besides speed, load and ambient."""
        return () if self.network is None else self.network.inputs

    @property
    def sensor_names(self) -> tuple[str, ...]:
        """The standard sensors of the asset's network."""
        return RING_SENSORS if self.network is None else tuple(self.network.sensors)


class SecuritySection(Section):
    """Who may read the metrics without a key (loopback always may), and how often one may ask."""

    allow_unauthenticated_metrics: bool = False
    #: Wrong keys that an address may offer before it has to wait.
    failed_logins_per_minute: int = Field(10, ge=1)
    #: Requests that a key may make; a minute's worth of them at once.
    requests_per_minute: int = Field(120_000, ge=1)


def _opcua_endpoint(endpoint: str) -> str:
    try:
        place = urlsplit(endpoint)
        listens = place.scheme == "opc.tcp" and bool(place.hostname and place.port)
    except ValueError:
        listens = False
    if not listens:
        raise ValueError("expected opc.tcp://HOST:PORT/PATH")
    return endpoint


class OpcUaSection(Section):
    """The tags as an OPC UA server (extra ``opcua``)."""

    enabled: bool = False
    endpoint: Annotated[str, AfterValidator(_opcua_endpoint)] = (
        "opc.tcp://127.0.0.1:4840/bearing-twin"
    )


class MqttSection(Section):
    """The broker that tags and alarms are published to (extra ``mqtt``)."""

    enabled: bool = False
    host: str = Field("127.0.0.1", min_length=1)
    port: int = Field(1883, ge=1, le=65535)
    #: First levels of every topic.
    topic_prefix: str = Field("bearing-twin", pattern=r"^[^/+#$\s]+(/[^/+#\s]+)*$")
    username: str = ""
    password: SecretStr | None = None
    tls: bool = False
    #: Certificates of the authority that signed the broker's; without it the machine's own.
    ca_file: Path | None = None


class TlsSection(Section):
    """PEM files for HTTPS: the certificate (with its chain) and its private key."""

    certificate: Path
    key: Path


class Settings(BaseSettings):
    """The whole configuration of a service."""

    model_config = SettingsConfigDict(
        env_prefix="BEARING_TWIN__",
        env_nested_delimiter="__",
        extra="forbid",
        frozen=True,
        hide_input_in_errors=True,
    )

    service: ServiceSection = ServiceSection()
    retention: RetentionSection = RetentionSection()
    clock: ClockSection = ClockSection()
    security: SecuritySection = SecuritySection()
    opcua: OpcUaSection = OpcUaSection()
    mqtt: MqttSection = MqttSection()
    #: Sections of further publishers, by name; each is checked by the publisher itself.
    publishers: dict[str, TomlTable] = {}
    tls: TlsSection | None = None
    bearings: dict[str, BearingSection] = {}
    sources: tuple[TomlTable, ...] = ()
    #: What assets have in common; see `service.site.templates`.
    templates: tuple[TomlTable, ...] = ()
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

    @model_validator(mode="before")
    @classmethod
    def _complete_assets(cls, given: Any) -> Any:
        """Make assets from their templates, and put bearings in where they are named."""
        bearings, assets = given.get("bearings", {}), given.get("assets")
        templates = templates_by_name(given.get("templates"))
        if not isinstance(bearings, dict) or not isinstance(assets, list | tuple):
            return given
        known = {name: with_designation(table, name) for name, table in bearings.items()}
        return given | {
            "bearings": known,
            "assets": [
                _completed(asset, templates, known, f"assets[{number}]")
                if isinstance(asset, dict)
                else asset
                for number, asset in enumerate(assets)
            ],
        }

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

    def asset(self, table: TomlTable, key: str) -> AssetSection:
        """Check the table of an asset that is not in the file, as those of the file are checked.

        Parameters
        ----------
        table
            As in the file.
        key
            Names it in messages.

        Raises
        ------
        SettingsError
            One line for each error.
        """
        folder = folder_of_files.set(self.base_dir)
        try:
            templates = templates_by_name(self.templates)
            return AssetSection.model_validate(_completed(table, templates, self.bearings, key))
        except ValidationError as error:
            raise SettingsError(*describe_all(error, key)) from error
        finally:
            folder_of_files.reset(folder)

    def path(self, relative: Path | str) -> Path:
        """Resolve a path of the configuration against the directory of its file."""
        return self.base_dir / relative

    @property
    def data_dir(self) -> Path:
        """Directory of the store, the spool and checkpoints."""
        return self.path(self.service.data_dir)


def _completed(
    asset: TomlTable, templates: Mapping[str, TomlTable], bearings: Mapping[str, Any], key: str
) -> TomlTable:
    """Table of an asset with its template, and the bearing of the configuration that it names."""
    whole = from_template(asset, templates, key)
    named = whole.get("bearing")
    if isinstance(named, str) and named in bearings:
        return whole | {"bearing": bearings[named]}
    return whole


def load_settings(file: Path | None) -> Settings:
    """Read a configuration file and the environment.

    Parameters
    ----------
    file : pathlib.Path or None
        TOML file; None takes the defaults, relative to the present directory.

    Raises
    ------
    SettingsError
        If the file cannot be read or keys are wrong; one line for each, which names the file and
        the key.
    """
    document = {} if file is None else read_toml(file)
    base_dir = Path() if file is None else file.parent
    where = f"{file}: " if file else ""
    folder = folder_of_files.set(base_dir)
    try:
        return Settings(**document, base_dir=base_dir)
    except ValidationError as error:
        raise SettingsError(*(where + line for line in describe_all(error))) from error
    except UnreadableVariableError as error:
        raise SettingsError(f"environment: {error}; expected JSON text") from error
    except TypeError as error:
        raise SettingsError(f"{where}{error}") from error
    finally:
        folder_of_files.reset(folder)
