"""A web side on an open store."""

from tests.service.web.api.conftest import empty_store, patient, settings, world

__all__ = ["empty_store", "patient", "settings", "world"]
