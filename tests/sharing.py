"""Which tests go to one worker of pytest-xdist, and which of them begin first.

A file's tests stay together, for the services that they share; so do files that share one service
among them. What takes longest begins first: no worker is then left alone with it at the end.
"""

from collections.abc import Sequence

import pytest
from xdist.scheduler import LoadScopeScheduling

#: Files and folders, by the first words of their paths, whose tests share something that is slow
#: to start.
TOGETHER = (
    "tests/browser/",
    "tests/faults/test_wires",
    "tests/service/offline/",
    "tests/twin_core/identification/",
)
#: What takes longest, in this order; the rest follows as it was collected.
FIRST = (
    "tests/security/",
    "tests/browser/",
    "tests/faults/",
    "tests/integration/",
    "tests/service/cli/",
    "tests/service/jobs/",
    "tests/service/store/",
    "tests/service/lab/",
    "tests/service/offline/",
    "tests/twin_core/identification/",
    "tests/adapters/virtual_bench/",
)


class Sharing(LoadScopeScheduling):
    """Hands out files, and groups of files, in the order in which they were collected."""

    def _split_scope(self, nodeid: str) -> str:
        return group(nodeid)


def group(nodeid: str) -> str:
    """What a test is handed out with."""
    file = nodeid.partition("::")[0]
    return next((together for together in TOGETHER if file.startswith(together)), file)


def longest_first(items: Sequence[pytest.Item]) -> list[pytest.Item]:
    """Tests in the order in which they are handed out."""

    def rank(item: pytest.Item) -> int:
        ranks = (rank for rank, path in enumerate(FIRST) if item.nodeid.startswith(path))
        return next(ranks, len(FIRST))

    return sorted(items, key=rank)
