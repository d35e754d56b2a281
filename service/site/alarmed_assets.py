"""The assets of the configuration and of the store, as alarm settings need them."""

from collections.abc import Collection, Mapping

from service.domain.upload_limits import in_time
from service.site.alarm_overlay import AlarmedAsset, Overlay, in_effect
from service.site.asset_section import AssetSection
from service.site.asset_tables import check_asset, of_section
from service.site.configuration import SettingsError, TomlTable
from service.site.settings import Settings
from service.site.wiring import wire


def alarmed_assets(
    settings: Settings,
    tables: Mapping[str, TomlTable],
    wanted: Collection[str] | None = None,
    seconds: float | None = None,
) -> dict[str, AlarmedAsset]:
    """Give assets by id; those of the store that do not fit the configuration are left out.

    ``seconds``: of processor time that this may take; None: any. Raises `UploadTooLargeError` if it
    takes longer.
    """
    wanted = None if wanted is None else set(wanted)
    of_file = [one for one in settings.assets if wanted is None or one.id in wanted]
    found: dict[str, AlarmedAsset] = {}
    if wanted is None and of_file:
        channels = wire(settings).channels
        found = {one.id: AlarmedAsset(one, channels[one.id]) for one in of_file}
    else:
        for section in in_time(of_file, seconds):
            facts = of_section(settings, section).wiring.channels[section.id]
            found[section.id] = AlarmedAsset(section, facts)
    for name, table in in_time(tables.items(), seconds):
        if name in found or (wanted is not None and name not in wanted):
            continue
        try:
            checked = check_asset(settings, name, table)
        except SettingsError:
            continue
        facts = checked.wiring.channels[name]
        found[name] = AlarmedAsset(checked.section, facts, "provisioned")
    return found


def asset_in_effect(
    settings: Settings, name: str, table: TomlTable | None, overlay: Overlay
) -> AssetSection | None:
    """Give the section of an asset with its limits in effect.

    Returns None without such an asset, or where it does not fit the configuration.
    """
    tables = {} if table is None else {name: table}
    found = alarmed_assets(settings, tables, {name}).get(name)
    return None if found is None else in_effect(found, overlay).section
