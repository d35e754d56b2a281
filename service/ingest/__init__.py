"""Ingest: from the drivers to the live twins and the store, losing nothing."""

from service.ingest.ingest import Ingest

__all__ = ["Ingest"]
