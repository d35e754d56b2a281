"""Batches on a Dask cluster (extra ``fleet``).

The scheduler computes a batch again whose worker died. A finished result lives in the memory of
one worker: it is fetched as soon as it is there.
"""

import asyncio
import logging
import ssl
import threading
from collections.abc import AsyncIterator
from concurrent.futures import CancelledError as LostConnectionError
from contextlib import asynccontextmanager
from typing import Any, Final
from uuid import uuid4

from distributed import Client
from distributed.comm.core import CommClosedError
from distributed.scheduler import KilledWorker
from distributed.security import Security
from threadpoolctl import threadpool_limits

from service.domain.errors import ServiceError, TemporaryError
from service.features.nights.account import ExecutorName
from service.features.nights.batch_executors import STALLED_AFTER_WALL_S, BatchFailedError
from service.features.nights.batches import run_batch
from service.site.fleet_section import SchedulerAddress

_CONNECT_WALL_S: Final = 30.0
#: Workers may be started after the scheduler, or all of them again.
_NO_WORKERS_WALL_S: Final = 300.0
_POLL_WALL_S: Final = 5.0

_alone = threading.Lock()


class ClusterUnavailableError(TemporaryError):
    """The scheduler or all its workers are offline; the text says which."""


def run_batch_alone(content: bytes) -> bytes:
    """Compute a batch in a worker: one at a time, and on one core.

    More threads of the linear algebra would change the last bits of the results.
    """
    with _alone, threadpool_limits(limits=1, user_api="blas"):
        return run_batch(content)


@asynccontextmanager
async def dask_batches(scheduler: SchedulerAddress) -> AsyncIterator["DaskBatches"]:
    """Connect to a scheduler for the length of an ``async with`` block.

    Raises
    ------
    ClusterUnavailableError
        If it does not answer, or has no worker.
    ServiceError
        If the certificates cannot be used.
    """
    # What goes wrong is reported once, by what is raised here.
    for name in ("distributed", "distributed.client"):  # each has a level of its own
        logging.getLogger(name).setLevel(logging.CRITICAL)
    security = None
    if scheduler.ca_file is not None:
        security = Security(
            tls_ca_file=str(scheduler.ca_file),
            tls_client_cert=str(scheduler.certificate_file),
            tls_client_key=str(scheduler.key_file),
            require_encryption=True,
        )
    try:
        client = await Client(
            scheduler.address,
            security=security,
            asynchronous=True,
            timeout=_CONNECT_WALL_S,
            set_as_default=False,
            name="bearing-twin-fleet-identify",
        )
    except (OSError, TimeoutError) as error:
        if ssl.SSLError.__name__ in str(error):  # Dask keeps no more of it than the text
            raise ServiceError(
                f"scheduler {scheduler.address}: one side refuses the other's certificate ({error})"
            ) from error
        raise ClusterUnavailableError(
            f"scheduler {scheduler.address}: does not answer ({error})"
        ) from error
    except ValueError as error:
        raise ServiceError(f"scheduler {scheduler.address}: {error}") from error
    try:
        try:
            await client.wait_for_workers(1, timeout=_NO_WORKERS_WALL_S)
        except TimeoutError as error:
            raise _no_workers(scheduler.address) from error
        threads = await client.nthreads()
        batches = DaskBatches(client, scheduler.address, len(threads))
        client.subscribe_topic("all", batches.note)
        yield batches
    finally:
        await client.close()


class DaskBatches:
    """Workers of a Dask cluster, one batch at a time on each.

    Parameters
    ----------
    client : distributed.Client
        Connected, asynchronous.
    address : str
        Of the scheduler, for messages.
    worker_count : int
        How many workers there are at the start.
    """

    name: ExecutorName = "dask"

    def __init__(self, client: Client, address: str, worker_count: int) -> None:
        self.worker_count = worker_count
        self.workers_lost = 0
        self._client, self._address = client, address

    def note(self, event: tuple[float, Any]) -> None:
        """Count a worker that died, from the scheduler's events."""
        facts = event[1]
        if facts.get("action") == "remove-worker" and not facts.get("expected"):
            self.workers_lost += 1

    async def compute(self, content: bytes) -> bytes:
        """Have a worker of the cluster compute a batch."""
        future = self._client.submit(
            run_batch_alone, content, key=f"bearing-twin-{uuid4().hex}", pure=False
        )
        result = asyncio.ensure_future(future.result())
        try:
            computing_s = 0.0
            while not result.done():
                await self._some_workers()
                await asyncio.wait({result}, timeout=_POLL_WALL_S)
                # Not the time in which it waits for a worker.
                if await self._is_computed(future.key):
                    computing_s += _POLL_WALL_S
                if computing_s > STALLED_AFTER_WALL_S:
                    raise BatchFailedError(
                        f"a worker has not finished it within {STALLED_AFTER_WALL_S:g} s"
                    )
            found: bytes = result.result()
            return found
        except KilledWorker as error:
            raise BatchFailedError("several workers died of it, one after the other") from error
        except (LostConnectionError, CommClosedError, OSError) as error:
            raise ClusterUnavailableError(
                f"scheduler {self._address}: the connection is lost ({error})"
            ) from error
        except ModuleNotFoundError as error:
            raise ServiceError(
                f"a worker of {self._address}: {error}; expected bearing-twin with the extra "
                "fleet there, too"
            ) from error
        finally:
            result.cancel()
            future.release()

    async def _is_computed(self, key: str) -> bool:
        tasks = await self._client.processing()
        return any(key in keys for keys in tasks.values())

    async def _some_workers(self) -> None:
        if not await self._client.nthreads():
            try:
                await self._client.wait_for_workers(1, timeout=_NO_WORKERS_WALL_S)
            except TimeoutError as error:
                raise _no_workers(self._address) from error


def _no_workers(address: str) -> ClusterUnavailableError:
    return ClusterUnavailableError(
        f"scheduler {address}: no worker for {_NO_WORKERS_WALL_S:g} s; expected at least one"
    )
