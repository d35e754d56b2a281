"""Takes up what is changed of alarm settings while the cell runs."""

import asyncio
import contextlib
from collections.abc import Mapping

import structlog
from anyio import to_thread

from service.cell.core import Core
from service.live.asset import AssetRuntime
from service.live.guard import Guard
from service.site.alarm_overlay import AlarmedAsset, Overlay, in_effect
from service.store import Store, StoreUnavailableError
from service.tasks import Part

#: Wall seconds between two looks into the store: a command writes there without asking the cell.
LOOK_EVERY_WALL_S = 2.0

_log = structlog.get_logger(__name__)


def part(core: Core) -> Part:
    """Make the part of the cell."""
    return AlarmTuning(core.store, core.assets)


class AlarmTuning(Part):
    """Keeps limits and alarm settings of the twins those of the configuration and of the store.

    Parameters
    ----------
    store : Store
        Where the changes are.
    assets : mapping of str to AssetRuntime
        The twins that run.
    """

    name = "alarm settings"

    def __init__(self, store: Store, assets: Mapping[str, AssetRuntime]) -> None:
        self._store = store
        self._assets = assets
        self._revision = 0
        self._overlays: dict[str, Overlay] = {}
        # The assets as configured, each with the number of the twin that was made of it.
        self._bases: dict[str, tuple[int, AlarmedAsset]] = {}
        self._applying = asyncio.Lock()

    def read_store(self) -> None:
        """Read what there is at the start."""
        self._revision = self._store.alarm_overlays.revision()
        self._overlays = dict(self._store.alarm_overlays.present())

    def settle(self, twin: AssetRuntime) -> None:
        """Let a twin, new or not, judge by what is in effect of its asset."""
        known = self._bases.get(twin.id)
        if known is None or known[0] != twin.make_number:
            base = AlarmedAsset(twin.settings, twin.facts)
            known = self._bases[twin.id] = twin.make_number, base
        effective = in_effect(known[1], self._overlays.get(twin.id, {}))
        for (kind, channel, level), why in effective.problems.items():
            _log.error(
                "alarm_setting_not_in_effect",
                asset=twin.id,
                kind=kind,
                channel=channel,
                level=level,
                reason=why,
            )
        twin.change_alarms(effective.section, effective.overrides)

    async def run(self) -> None:
        """Take up what others write into the store, until cancelled."""
        looking = Guard("taking_up_alarm_settings", "")
        while True:
            await asyncio.sleep(LOOK_EVERY_WALL_S)
            # The writer of samples reports a store that is not reachable.
            with looking(), contextlib.suppress(StoreUnavailableError):
                await self.apply_changes()

    async def apply_changes(self) -> None:
        """Take up what has changed in the store.

        Raises
        ------
        StoreUnavailableError
            If the store does not answer.
        """
        async with self._applying:
            settings = self._store.alarm_overlays
            revision, changed = await to_thread.run_sync(settings.changed_since, self._revision)
            if not changed:
                return
            found = await to_thread.run_sync(settings.present, changed)
            for name in changed:
                self._overlays[name] = found.get(name, {})
                if name in self._assets:
                    self.settle(self._assets[name])
            self._revision = revision
            _log.info("alarm_settings_taken_up", assets=len(changed), revision=revision)
