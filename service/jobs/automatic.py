"""Automatic re-identification: when enough new and varied low-risk windows have come."""

import asyncio
from collections.abc import Mapping

import structlog

from adapters.protocol import Clock
from service.domain.errors import JobConflictError, RequestRefusedError
from service.domain.requests import IdentificationRequest
from service.jobs.family import NewSisters
from service.jobs.history import AssetHistory
from service.jobs.manager import IdentificationJobs
from service.jobs.runner import AUTOMATIC
from twin_core.windows import Window

LOOK_EVERY_S = 300.0
LOOK_LEAST_WALL_S = 1.0

_log = structlog.get_logger(__name__)


async def identify_automatically(
    jobs: IdentificationJobs, histories: Mapping[str, AssetHistory], clock: Clock
) -> None:
    """Look at every asset's windows from time to time and queue a job where they are worth it.

    So is it when sisters have been where the asset has not, and its model does not know of them.

    What was tried once is not tried again until new data have come, also when the job failed or
    someone cancelled it.
    """
    tried: dict[str, list[Window]] = {}
    learned: dict[str, NewSisters] = {}
    while True:
        await asyncio.sleep(max(LOOK_EVERY_S / clock.rate, LOOK_LEAST_WALL_S))
        for asset_id, history in list(histories.items()):
            if asset_id not in histories or jobs.busy(asset_id):
                continue
            try:
                found = await history.windows()
                ahead = await jobs.new_sisters(asset_id) if found else None
                if ahead == learned.get(asset_id):
                    ahead = None
                if not ahead and not await history.are_worth_identifying(
                    found, tried.get(asset_id, [])
                ):
                    continue
                await jobs.create(asset_id, IdentificationRequest(), None, AUTOMATIC)
                tried[asset_id] = found
                if ahead:
                    learned[asset_id] = ahead
            except (JobConflictError, RequestRefusedError) as error:
                _log.info("automatic_identification_put_off", asset=asset_id, reason=str(error))
            except Exception:
                # A store that does not answer, data that no one thought of: the next look may
                # fare better, and the other assets must not wait for this one.
                _log.exception("automatic_identification_failed", asset=asset_id)
