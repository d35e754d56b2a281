"""Metrics of several processes in one answer."""

from collections.abc import Mapping

from prometheus_client import Metric
from prometheus_client.exposition import generate_latest
from prometheus_client.parser import text_string_to_metric_families
from prometheus_client.registry import Collector, CollectorRegistry


class _Families(Collector):
    def __init__(self, families: list[Metric]) -> None:
        self._families = families

    def collect(self) -> list[Metric]:
        return self._families


def merged(texts: Mapping[str, bytes]) -> bytes:
    """Put the metrics of several cells together: each series gets the label ``cell``.

    Parameters
    ----------
    texts : mapping of str to bytes
        What each cell exposes, by its name.
    """
    families: dict[str, Metric] = {}
    for cell, text in texts.items():
        for family in text_string_to_metric_families(text.decode()):
            whole = families.setdefault(
                family.name, Metric(family.name, family.documentation, family.type)
            )
            whole.samples += [
                sample._replace(labels={**sample.labels, "cell": cell}) for sample in family.samples
            ]
    registry = CollectorRegistry()
    registry.register(_Families(list(families.values())))
    return generate_latest(registry)
