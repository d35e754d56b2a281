"""The upkeep of days is tested in no time."""

from jumping import jumping_in, seen_threads

__all__ = ["seen_threads"]

pytest_asyncio_loop_factories = jumping_in("test_retention_work.py")
