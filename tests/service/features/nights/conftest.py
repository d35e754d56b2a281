"""A store with hours of a real run, and stores of both kinds."""

from tests.service.jobs.conftest import (
    _compiled,
    clock,
    run_file,
    run_store,
    shop,
)
from tests.service.store.conftest import postgresql, store

__all__ = [
    "_compiled",
    "clock",
    "postgresql",
    "run_file",
    "run_store",
    "shop",
    "store",
]
