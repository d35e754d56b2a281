"""From the configuration to drivers: which channel of which asset comes from which source."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TypeVar

from pydantic import BaseModel, ValidationError

from adapters.configuration import ConfigurationError, MeasuredChannel, SourceConfig, suggestion
from adapters.protocol import ChannelBinding, Clock, Driver, DriverSpec, PlanBinding
from adapters.registry import DRIVERS
from adapters.words import shown
from service.domain.channels import CONTROLLER_CHANNELS, unit_of
from service.site.asset_section import AssetSection
from service.site.check_limits import CheckLimits, limits_of, within_machine
from service.site.configuration import SettingsError, TomlTable, describe_all
from service.site.machines.operating_ranges import operating_ranges
from service.site.settings import Settings

PUSH = "push"
_PUSHED = SourceConfig(name=PUSH, driver=PUSH)
_PLAN = "plan"
_Model = TypeVar("_Model", bound=BaseModel)
_LEAST_POLLED_AGE_S = 10.0
_PERIODS_UNTIL_STALE = 5.0


@dataclass(slots=True)
class SourceWiring:
    """One source with all that is read from it."""

    name: str
    spec: DriverSpec
    config: SourceConfig
    channels: list[ChannelBinding] = field(default_factory=list)
    plans: list[PlanBinding] = field(default_factory=list)

    def create(self, clock: Clock) -> Driver:
        """Make the driver; it connects when it is entered."""
        return self.spec.create(self.config, self.channels, self.plans, clock)


@dataclass(frozen=True, slots=True)
class ChannelFacts:
    """What the live side must know of a channel, whatever its source."""

    source: str
    max_age_s: float
    limits: CheckLimits = field(default_factory=CheckLimits)
    #: The least age limit, where the limit follows the observed interval; None: it is fixed.
    learned_from_s: float | None = None


@dataclass(frozen=True, slots=True)
class Wiring:
    """All sources, and the facts of every channel by asset."""

    sources: list[SourceWiring]
    channels: Mapping[str, Mapping[str, ChannelFacts]]

    @property
    def check_limits(self) -> dict[tuple[str, str], CheckLimits]:
        """What the values of every channel can do, by asset and channel."""
        return {
            (asset, channel): facts.limits
            for asset, channels in self.channels.items()
            for channel, facts in channels.items()
        }


@dataclass(frozen=True, slots=True)
class AssetTables:
    """The tables of an asset that the drivers check; ``key`` names it in messages."""

    key: str
    id: str
    channels: Mapping[str, TomlTable]
    controller: Mapping[str, TomlTable]

    @classmethod
    def of(cls, key: str, asset: AssetSection) -> "AssetTables":
        """Return those of a checked asset."""
        controller = {
            name: getattr(asset.controller, name) for name in (*CONTROLLER_CHANNELS, _PLAN)
        }
        given = {name: table for name, table in controller.items() if table is not None}
        return cls(key, asset.id, asset.channels, given)


def wire(settings: Settings) -> Wiring:
    """Check every source and channel of a configuration against its driver.

    Raises `SettingsError`: one line for each error: names the key, the value and what was expected.
    """
    return wire_assets(
        settings, {f"assets[{number}]": asset for number, asset in enumerate(settings.assets)}
    )


def wire_assets(settings: Settings, assets: Mapping[str, AssetSection]) -> Wiring:
    """As `wire`, of some assets, in the file or not, by the key that names them in messages."""
    tables = [AssetTables.of(key, asset) for key, asset in assets.items()]
    wiring, errors = wire_what_can_be(dict(enumerate(settings.sources)), tables, settings.base_dir)
    if errors:
        raise SettingsError(*errors)
    ranges = {asset.id: operating_ranges(asset.bearing) for asset in assets.values()}
    channels = {
        asset: {
            name: replace(facts, limits=within_machine(name, facts.limits, ranges[asset]))
            for name, facts in known.items()
        }
        for asset, known in wiring.channels.items()
    }
    return Wiring(wiring.sources, channels)


def with_assets(
    sources: Mapping[str, SourceWiring], assets: Mapping[str, Wiring | None]
) -> dict[str, SourceWiring]:
    """Give the sources with what they read for other assets; without any use a source is left out.

    ``assets``: what is read for some assets in the place of what is read for them now; None:
    nothing.
    """
    if not assets:
        return dict(sources)
    news: dict[str, list[SourceWiring]] = {}
    for wiring in assets.values():
        for source in wiring.sources if wiring is not None else ():
            news.setdefault(source.name, []).append(source)
    found: dict[str, SourceWiring] = {}
    for name in dict.fromkeys((*sources, *news)):
        before, added = sources.get(name), news.get(name, [])
        first = before or added[0]
        kept = [one for one in (before.channels if before else ()) if one.asset not in assets]
        plans = [one for one in (before.plans if before else ()) if one.asset not in assets]
        whole = SourceWiring(
            name,
            first.spec,
            first.config,
            kept + [one for source in added for one in source.channels],
            plans + [one for source in added for one in source.plans],
        )
        if before is not None and _reads_the_same(whole, before):
            whole = before
        if whole.channels or whole.plans:
            found[name] = whole
    return found


def _reads_the_same(one: SourceWiring, other: SourceWiring) -> bool:
    """Whether two read the same, in whatever order."""

    def read(source: SourceWiring) -> tuple[object, object]:
        channels = {(binding.asset, binding.channel): binding.config for binding in source.channels}
        return channels, {binding.asset: binding.config for binding in source.plans}

    return read(one) == read(other)


def wire_what_can_be(
    sources: Mapping[int, TomlTable], assets: Sequence[AssetTables], base_dir: Path
) -> tuple[Wiring, list[str]]:
    """Check every source and channel against its driver, and go on after errors.

    Returns the wiring of all that is right, and one line per error.
    """
    errors: list[str] = []
    wired = _sources(sources, base_dir, errors)
    facts: dict[str, dict[str, ChannelFacts]] = {}
    for asset in assets:
        facts[asset.id] = {}
        channels = {f"{asset.key}.channels.{name}": table for name, table in asset.channels.items()}
        channels |= {
            f"{asset.key}.controller.{name}": asset.controller[name]
            for name in CONTROLLER_CHANNELS
            if name in asset.controller
        }
        for key, table in channels.items():
            name = key.rpartition(".")[2]
            try:
                found = _wire_channel(asset.id, name, table, key, wired)
            except SettingsError as error:
                errors += error.lines
            else:
                if found is not None:
                    facts[asset.id][name] = found
        if _PLAN in asset.controller:
            try:
                _wire_plan(asset, wired)
            except SettingsError as error:
                errors += error.lines
    right = [source for source in wired.values() if source is not None]
    # Also a source without channels: that its DBC file is missing is an error.
    for source in right:
        errors += _check(source)
        bound = {(one.asset, one.channel) for one in source.channels}
        for asset_id, known in facts.items():
            for name in [name for name, one in known.items() if one.source == source.name]:
                if (asset_id, name) not in bound:
                    del known[name]
    return Wiring([one for one in right if one.channels or one.plans], facts), errors


def _sources(
    tables: Mapping[int, TomlTable], base_dir: Path, errors: list[str]
) -> dict[str, SourceWiring | None]:
    """Return the sources by name; None for one with an error, which is noted."""
    found: dict[str, SourceWiring | None] = {}
    for number, table in tables.items():
        name = str(table.get("name"))
        try:
            found[name] = source_of(f"sources[{number}]", table, base_dir)
        except SettingsError as error:
            found[name] = None
            errors += error.lines
    return found


def source_of(key: str, table: TomlTable, base_dir: Path) -> SourceWiring:
    """Check the table of one source against its driver.

    Raises `SettingsError`: one line for each error, which begins with ``key``.
    """
    driver = table.get("driver")
    if not isinstance(driver, str) or driver not in DRIVERS:
        raise SettingsError(f"{key}.driver = {driver!r}: {suggestion(str(driver), DRIVERS)}")
    name = table.get("name")
    if not isinstance(name, str) or not name or name == PUSH:
        raise SettingsError(f"{key}.name = {shown(name)}: expected a name other than 'push'")
    spec = DRIVERS[driver]
    return SourceWiring(name, spec, _validated(spec.source_model, table, key, base_dir=base_dir))


def _wire_channel(
    asset: str,
    name: str,
    table: TomlTable,
    key: str,
    sources: Mapping[str, SourceWiring | None],
) -> ChannelFacts | None:
    """Bind a channel to its source; None where the source itself has an error."""
    source_name = _source_name(table, sources, key)
    if source_name == PUSH:
        return _facts(name, PUSH, _PUSHED, _validated(MeasuredChannel, table, key))
    source = sources[source_name]
    if source is None:
        return None
    config = _validated(source.spec.channel_model, table, key)
    source.channels.append(ChannelBinding(asset, name, config, unit_of(name)))
    return _facts(name, source_name, source.config, config)


def _source_name(table: TomlTable, sources: Mapping[str, SourceWiring | None], key: str) -> str:
    name = table.get("source")
    if name is None:
        raise SettingsError(f"{key}.source: missing; expected the name of a source or 'push'")
    if not isinstance(name, str) or (name != PUSH and name not in sources):
        raise SettingsError(
            f"{key}.source = {shown(name)}: {suggestion(str(name), [*sources, PUSH])}"
        )
    return name


def _wire_plan(asset: AssetTables, sources: Mapping[str, SourceWiring | None]) -> None:
    table, key = asset.controller[_PLAN], f"{asset.key}.controller.{_PLAN}"
    source_name = _source_name(table, sources, key)
    source = sources.get(source_name)
    if source is None and source_name in sources:
        return
    if source is None or source.spec.plan_model is None:
        raise SettingsError(f"{key}.source = {source_name!r}: this source cannot carry a plan")
    source.plans.append(PlanBinding(asset.id, _validated(source.spec.plan_model, table, key)))


def _check(source: SourceWiring) -> list[str]:
    """Let the driver check what is bound to its source; what is wrong is no longer bound."""
    check, config = source.spec.check, source.config
    try:
        check(config, source.channels, source.plans)
    except ConfigurationError as error:
        whole = str(error)
    else:
        return []
    # The driver names the first error only. One by one, every channel and plan names its own.
    errors: list[str] = []

    def is_right(channels: list[ChannelBinding], plans: list[PlanBinding]) -> bool:
        try:
            check(config, channels, plans)
        except ConfigurationError as error:
            errors.append(str(error))
            return False
        return True

    source.channels = [one for one in source.channels if is_right([one], [])]
    source.plans = [one for one in source.plans if is_right([], [one])]
    if not errors:  # two that do not go together
        source.channels, source.plans = [], []
    return list(dict.fromkeys(errors or [whole]))


def _validated(
    model: type[_Model], table: TomlTable, key: str, base_dir: Path | None = None
) -> _Model:
    try:
        return model.model_validate(table, context={"base_dir": base_dir} if base_dir else None)
    except ValidationError as error:
        raise SettingsError(*describe_all(error, key)) from error


def _facts(
    name: str, source_name: str, source: SourceConfig, channel: MeasuredChannel
) -> ChannelFacts:
    max_age_s, learned_from_s = _max_age_s(source, channel)
    return ChannelFacts(source_name, max_age_s, limits_of(name, source, channel), learned_from_s)


def _max_age_s(source: SourceConfig, channel: MeasuredChannel) -> tuple[float, float | None]:
    """Age at which a channel is stale, and the least it may be where it is learned.

    As configured, else five expected periods of it or of its source, else five of its observed
    periods.
    """
    if channel.max_age_s is not None:
        return channel.max_age_s, None
    period_s = channel.expected_period_s or source.expected_period_s
    if period_s is not None:
        return max(_LEAST_POLLED_AGE_S, _PERIODS_UNTIL_STALE * period_s), None
    return source.first_max_age_s, source.least_max_age_s
