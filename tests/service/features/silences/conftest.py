"""Silences on the application of the web side's tests."""

from tests.service.web.api.conftest import empty_store, patient, settings, world

__all__ = ["empty_store", "patient", "settings", "world"]
