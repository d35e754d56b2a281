"""What `check` warns of."""

from typing import TYPE_CHECKING

from service.cli.known_assets import store_if_there
from service.site.settings import Settings

if TYPE_CHECKING:
    from service.site.alarm_overlay import AlarmedAsset
    from service.store import Store


def warnings(settings: Settings) -> list[str]:
    """Say which alarm settings in effect are not those of the configuration, one line each."""
    from service.site.alarm_overlay import SETTINGS, in_effect, rows_of
    from service.store import StoreError

    lines: list[str] = []
    try:
        with store_if_there(settings) as store:
            overlays = {} if store is None else store.alarm_overlays.present()
            if store is None or not overlays:
                return []
            assets = stored_assets(settings, store)
    except StoreError:  # nothing that is wrong with a configuration
        return []
    for name, asset in assets.items():
        overlay = overlays.get(name, {})
        for row in rows_of(asset, overlay):
            named = " ".join(part for part in row.name if part)
            for key in row.changed:
                if key in SETTINGS:
                    before, now = row.base[key], row.values[key]
                    lines.append(f"{name}: {named}: {key} is {now}, changed from {before}")
        for alarm, problem in in_effect(asset, overlay).problems.items():
            named = " ".join(part for part in alarm if part)
            lines.append(f"{name}: {named}: what was changed is not in effect: {problem}")
    return lines


def stored_assets(settings: Settings, store: "Store") -> "dict[str, AlarmedAsset]":
    """Give all assets of file and store with their alarms."""
    from service.site.alarmed_assets import alarmed_assets

    tables = {one.id: one.table or {} for one in store.assets.present()}
    return alarmed_assets(settings, tables)
