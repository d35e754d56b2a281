"""Which model version is the active one: in the store and in the live twin, always the same."""

import asyncio
import contextlib
from collections.abc import Mapping
from typing import Final

import anyio.to_thread
import structlog

from adapters.protocol import Clock
from service.documents.models import ModelDocument, model_document
from service.domain.errors import ActivationRefusedError
from service.jobs.models import active_model, why_not_of_this_asset
from service.live.asset import AssetRuntime
from service.live.guard import Guard
from service.store import AuditEntry, Store, StoreUnavailableError

#: Wall seconds between two looks into the store.
LOOK_EVERY_WALL_S: Final = 5.0

_log = structlog.get_logger(__name__)


class Activations:
    """Makes one version after the other the active one.

    Parameters
    ----------
    store, clock
        Where the versions are; process time.
    assets : mapping of str to AssetRuntime
        The live twins to be switched.

    Attributes
    ----------
    switching : asyncio.Lock
        Held while a twin and its version change.
    """

    def __init__(self, store: Store, clock: Clock, assets: Mapping[str, AssetRuntime]) -> None:
        self._store = store
        self._clock = clock
        self._assets = assets
        # Of two activations at a time, the one that wins in the store must win in the twin.
        self.switching = asyncio.Lock()
        # Versions that cannot run the asset as it is configured here: said once.
        self._foreign: set[tuple[str, int]] = set()

    async def activate(
        self,
        asset_id: str,
        version: int,
        who: str,
        comment: str | None,
        force: bool,
        line: AuditEntry | None = None,
    ) -> ModelDocument:
        """Make a version the active one; see `service.jobs.manager.IdentificationJobs`.

        The line of the audit trail, where there is one, is written in the same transaction.
        """
        async with self.switching:
            asset = self._assets[asset_id]
            model = await anyio.to_thread.run_sync(self._store.models.version, asset_id, version)
            if model is None:
                raise KeyError(version)
            foreign = why_not_of_this_asset(asset.settings, model)
            if foreign:
                raise ActivationRefusedError(f"version {version}: {foreign}")
            if model.status == "rejected" and not (force and comment):
                raise ActivationRefusedError(
                    f"version {version} was rejected ({model.reason}); "
                    'expected {"force": true} with a comment to activate it anyway'
                )
            activated = await anyio.to_thread.run_sync(
                self._store.models.activate,
                asset_id,
                version,
                who,
                comment or f"activated by {who}",
                self._clock.now_us(),
                line,
            )
            active = await anyio.to_thread.run_sync(active_model, asset.settings, activated)
            asset.switch(active, who, comment or "")
        await asyncio.sleep(0)  # a poll that is due comes before the document
        return model_document(activated)

    async def follow(self) -> None:
        """Take up what others make the active version, until cancelled.

        A command that identifies a fleet writes into the store without asking anybody.
        """
        looking = Guard("taking_up_models", "")
        while True:
            await asyncio.sleep(LOOK_EVERY_WALL_S)
            # A store that is away is reported by those that write.
            with looking(), contextlib.suppress(StoreUnavailableError):
                await self.look()

    async def look(self) -> None:
        """Let each twin run on the version that is active in the store.

        Raises
        ------
        StoreUnavailableError
            If the store does not answer.
        """
        async with self.switching:
            numbers = await anyio.to_thread.run_sync(self._store.models.active_numbers)
            for asset_id, asset in list(self._assets.items()):
                number = numbers.get(asset_id)
                if number not in (None, asset.active.version):
                    await self._take_up(asset)

    async def _take_up(self, asset: AssetRuntime) -> None:
        version = await anyio.to_thread.run_sync(self._store.models.active, asset.id)
        if version is None or (asset.id, version.version) in self._foreign:
            return
        foreign = why_not_of_this_asset(asset.settings, version)
        if foreign:
            self._foreign.add((asset.id, version.version))
            _log.warning(
                "model_not_taken_up", asset=asset.id, version=version.version, reason=foreign
            )
            return
        journal = await anyio.to_thread.run_sync(self._store.models.activations, asset.id)
        asset.switch(active_model(asset.settings, version), journal[-1].who, journal[-1].comment)
