from collections.abc import Iterator
from pathlib import Path

import pytest

from service.store import Outbox, Store


@pytest.fixture
def store(tmp_path: Path) -> Iterator[Store]:
    with Store.open("", tmp_path) as store:
        yield store


@pytest.fixture
def outbox(store: Store, tmp_path: Path) -> Iterator[Outbox]:
    with Outbox.open(tmp_path, store) as outbox:
        yield outbox
