"""The model version that each twin runs on; a twin without one gets its priors."""

from collections.abc import Sequence

import structlog

from adapters.protocol import Clock
from service.jobs.models import active_model, first_model, why_not_of_this_asset
from service.live.estimate import RunningModel
from service.site.asset_section import AssetSection
from service.store import FirstModel, Store

_log = structlog.get_logger(__name__)


def active_models(
    store: Store, clock: Clock, assets: Sequence[AssetSection]
) -> dict[str, RunningModel]:
    """Give the model version of each asset; where there is none that fits, its priors.

    What the store lacks is written in one transaction.
    """
    stored = store.models.active_of([asset.id for asset in assets])
    begun: dict[str, FirstModel] = {}
    for asset in assets:
        why = "before the first identification"
        active = stored.get(asset.id)
        if active is not None:
            foreign = why_not_of_this_asset(asset, active)
            if foreign is None:
                continue
            _log.warning("active_model_replaced", asset=asset.id, reason=foreign)
            why = f"version {active.version}: {foreign}"
        begun[asset.id] = FirstModel(first_model(asset), f"default parameters; {why}")
    if begun:
        stored |= store.models.begin(begun, "service", clock.now_us())
    return {asset.id: active_model(asset, stored[asset.id]) for asset in assets}
