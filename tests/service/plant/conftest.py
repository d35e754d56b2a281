from collections.abc import Iterator
from pathlib import Path

import pytest

from service.plant.protocol import Host
from service.security.audit_trail import AuditTrail
from service.security.authenticator import Authenticator
from service.store import Outbox, Store


@pytest.fixture
def store(tmp_path: Path) -> Iterator[Store]:
    with Store.open("", tmp_path) as store:
        yield store


@pytest.fixture
def outbox(store: Store, tmp_path: Path) -> Iterator[Outbox]:
    with Outbox.open(tmp_path, store) as outbox:
        yield outbox


@pytest.fixture
def host(store: Store, outbox: Outbox, tmp_path: Path) -> Host:
    """What publishers may use."""
    return Host(Authenticator(store), AuditTrail(outbox), tmp_path)
