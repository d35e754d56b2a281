"""Ingest: from the drivers to the live twins and the store, losing nothing."""

from service.ingest.ingest import Ingest
from service.ingest.quality import QualityChecks
from service.ingest.spool import Spool

__all__ = ["Ingest", "QualityChecks", "Spool"]
