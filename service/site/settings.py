"""The configuration file: one TOML document, checked before anything starts.

Every setting can also come from the environment as ``BEARING_TWIN__SECTION__KEY`` (arrays as JSON
text), which wins over the file. Errors name the key, the value and what was expected.
"""

import ipaddress
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Self
from urllib.parse import urlsplit

from pydantic import (
    AfterValidator,
    Field,
    SecretStr,
    ValidationError,
    create_model,
    model_validator,
)
from pydantic_settings import (
    BaseSettings,
    EnvSettingsSource,
    PydanticBaseSettingsSource,
    SettingsConfigDict,
)

from adapters.configuration import first_repeated
from service.domain.section import Section
from service.domain.texts import EXPECTED, is_one_line
from service.feature_folders import modules
from service.site.asset_section import AssetSection
from service.site.configuration import SettingsError, TomlTable, describe_all, read_toml
from service.site.environment import by_variable, environment_errors, is_variable
from service.site.fleet_section import FleetSection
from service.site.machines.bearings import BearingSection, with_designation
from service.site.machines.networks import (
    folder_of_files,
)
from service.site.templates import from_template, templates_by_name


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

    Journal of the alarms and forecast ledger (process time), and audit trail (wall clock): with 0
    without limit.
    """

    raw_days: Days | None = None
    second_days: Days | None = None
    minute_days: Days | None = None
    hour_days: Days | None = None
    journal_days: float = Field(_TEN_YEARS_DAYS, ge=0, le=100_000)
    audit_days: Annotated[float, AfterValidator(_kept_a_year)] = Field(
        _TEN_YEARS_DAYS, ge=0, le=100_000
    )
    forecast_days: float = Field(30, ge=0, le=100_000)


class ClockSection(Section):
    """Process seconds per wall second; above 1 only with the virtual bench."""

    rate: float = Field(1.0, gt=0, le=3600)


class JobsSection(Section):
    """Identifications in the background."""

    #: How many run at a time, each in a process of its own on one core.
    workers: int = Field(1, ge=1, le=64)


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
    #: Of one's own authority, and its RSA key; without them the service makes a certificate.
    certificate: Path | None = None
    private_key: Path | None = None

    @model_validator(mode="after")
    def _both_files(self) -> "OpcUaSection":
        if (self.certificate is None) != (self.private_key is None):
            raise ValueError("expected both certificate and private_key, or neither")
        return self


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


class ModbusServerSection(Section):
    """The tags as registers for a PLC, read-only; see `docs/connect/modbus-server.md`."""

    enabled: bool = False
    host: str = Field("127.0.0.1", min_length=1)
    port: int = Field(1502, ge=1, le=65535)
    #: ``ASSET/TAG`` in the order of the registers; empty for the usual ones of every asset.
    tags: tuple[str, ...] = ()


class TlsSection(Section):
    """PEM files for HTTPS: the certificate (with its chain) and its private key."""

    certificate: Path
    key: Path


class CoreSettings(BaseSettings):
    """The configuration of a service but for the sections of features."""

    model_config = SettingsConfigDict(
        env_prefix="BEARING_TWIN__",
        env_nested_delimiter="__",
        extra="forbid",
        frozen=True,
        hide_input_in_errors=True,
    )

    service: ServiceSection = ServiceSection()
    jobs: JobsSection = JobsSection()
    retention: RetentionSection = RetentionSection()
    clock: ClockSection = ClockSection()
    security: SecuritySection = SecuritySection()
    fleet: FleetSection = FleetSection()
    opcua: OpcUaSection = OpcUaSection()
    mqtt: MqttSection = MqttSection()
    modbus_server: ModbusServerSection = ModbusServerSection()
    #: Sections of further publishers, by name; each is checked by the publisher itself.
    publishers: dict[str, TomlTable] = {}
    tls: TlsSection | None = None
    bearings: dict[str, BearingSection] = {}
    sources: tuple[TomlTable, ...] = ()
    #: What assets have in common; see `service.site.templates`.
    templates: tuple[TomlTable, ...] = ()
    assets: tuple[AssetSection, ...] = ()
    base_dir: Path = Field(Path(), exclude=True)
    #: What it was read from.
    file: Path | None = Field(None, exclude=True)

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
        given = _with_fleet_database(given)
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
            twice = first_repeated(names)
            if twice is not None:
                raise ValueError(f"{what}: the name {twice!r} is used twice; expected unique")
        return self

    @model_validator(mode="after")
    def _names_are_lines(self) -> Self:
        names = [
            (f"{key}[{number}].name", str(one.get("name")))
            for key, tables in (("sources", self.sources), ("templates", self.templates))
            for number, one in enumerate(tables)
        ]
        lines = [f"{key} = {name!r}: {EXPECTED}" for key, name in names if not is_one_line(name)]
        for number, asset in enumerate(self.assets):
            lines += (f"assets[{number}].{line}" for line in asset.lines_in_names)
        if lines:
            raise SettingsError(*lines)
        return self

    @model_validator(mode="after")
    def _fleet_is_whole(self) -> Self:
        fleet = self.fleet
        if bool(fleet.database_url) != bool(fleet.nats_url):
            missing = "nats_url" if fleet.database_url else "database_url"
            raise ValueError(f"fleet.{missing}: missing; several cells need both addresses")
        if fleet.database_url and self.service.database_url != fleet.database_url:
            raise ValueError(
                "service.database_url: differs from fleet.database_url; expected one of them"
            )
        if fleet.database_url and self.clock.rate != 1.0:
            raise ValueError(
                f"clock.rate = {self.clock.rate:g}: expected 1 with [fleet]: cells on several "
                "machines have no other clock in common"
            )
        return self

    @property
    def is_fleet(self) -> bool:
        """Whether several cells share the machines."""
        return bool(self.fleet.nats_url)

    def asset(self, table: TomlTable, key: str) -> AssetSection:
        """Check the table of an asset that is not in the file, as those of the file are checked.

        Raises `SettingsError`: one line for each error.
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


if TYPE_CHECKING:
    Settings = CoreSettings
else:
    _sections = [feature.Sections for _, feature in modules("settings")]
    Settings = create_model(
        "Settings",
        __base__=(CoreSettings, *_sections),
        __module__=__name__,
        __doc__="The whole configuration of a service.",
    )


def _with_fleet_database(given: Any) -> Any:
    """Let the service keep everything in the database of the fleet."""
    fleet, service = given.get("fleet"), given.get("service", {})
    url = fleet.get("database_url") if isinstance(fleet, dict) else None
    if not url or not isinstance(service, dict) or service.get("database_url"):
        return given
    return given | {"service": service | {"database_url": url}}


def _completed(
    asset: TomlTable, templates: Mapping[str, TomlTable], bearings: Mapping[str, Any], key: str
) -> TomlTable:
    """Table of an asset with its template, and the bearing of the configuration that it names."""
    whole = from_template(asset, templates, key)
    named = whole.get("bearing")
    if isinstance(named, str) and named in bearings:
        return whole | {"bearing": bearings[named]}
    return whole


def load_settings(file: Path | None, text: str | None = None) -> Settings:
    """Read a configuration file and the environment.

    ``text``: what the file would hold, when that is not what it holds now. Raises `SettingsError`
    if the file cannot be read or keys are wrong; one line for each, which names the file and the
    key.
    """
    if wrong := environment_errors(Settings):
        raise SettingsError(*wrong)
    document = {} if file is None else read_toml(file, text)
    base_dir = Path() if file is None else file.parent
    where = f"{file}: " if file else ""
    folder = folder_of_files.set(base_dir)
    try:
        return Settings(**document, base_dir=base_dir, file=file)
    except ValidationError as error:
        lines = by_variable(describe_all(error))
        raise SettingsError(
            *(line if is_variable(line) else where + line for line in lines)
        ) from error
    except TypeError as error:
        raise SettingsError(f"{where}{error}") from error
    finally:
        folder_of_files.reset(folder)
