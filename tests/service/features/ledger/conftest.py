"""The live twin, the web side and the stores that the tests of other packages have."""

from jumping import jumping_in

from tests.service.live.conftest import executor, make_live
from tests.service.store.conftest import postgresql, store
from tests.service.web.api.conftest import empty_store, patient, settings, world

pytest_asyncio_loop_factories = jumping_in("test_keeping.py")

__all__ = [
    "empty_store",
    "executor",
    "make_live",
    "patient",
    "postgresql",
    "settings",
    "store",
    "world",
]
