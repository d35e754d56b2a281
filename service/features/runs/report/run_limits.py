"""The limits that a machine had when it ran."""

from service.features.runs.runs import Run
from service.site.alarmed_assets import asset_in_effect
from service.site.asset_section import AssetSection
from service.site.settings import Settings
from service.store import Store


def asset_of_run(settings: Settings, store: Store, run: Run) -> AssetSection | None:
    """Give the section of a run's asset with the limits in effect at the end of the run.

    What was changed later over REST or on the page is left out, so that the report of a run stays
    as it is. Of the configuration file only the present state is known. Returns None without such
    an asset, or where it does not fit the configuration.

    - ``run``: one that goes on has the limits of now.
    """
    in_file = any(one.id == run.asset for one in settings.assets)
    stored = None if in_file else store.assets.get(run.asset)
    changed = store.alarm_overlays.present({run.asset}, until_us=run.end_us)
    table = None if stored is None else stored.table
    return asset_in_effect(settings, run.asset, table, changed.get(run.asset, {}))
