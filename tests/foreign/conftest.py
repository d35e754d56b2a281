from tests.service.plant.conftest import outbox, store

__all__ = ["outbox", "store"]
