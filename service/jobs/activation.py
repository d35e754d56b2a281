"""Which model version is the active one: in the store and in the live twin, always the same."""

import asyncio
from collections.abc import Mapping

import anyio.to_thread

from adapters.protocol import Clock
from service.documents.models import ModelDocument, model_document
from service.domain.errors import ActivationRefusedError
from service.jobs.models import active_model, why_not_of_this_asset
from service.live.asset import AssetRuntime
from service.store import AuditEntry, Store


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
            asset.switch(active_model(asset.settings, activated), who, comment or "")
        return model_document(activated)
