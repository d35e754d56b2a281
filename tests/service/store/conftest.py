from collections.abc import Iterator
from pathlib import Path

import pytest
from postgresql import PostgreSQL, running_postgresql

from service.store import Store


@pytest.fixture(scope="session")
def postgresql() -> Iterator[PostgreSQL]:
    with running_postgresql() as server:
        yield server


@pytest.fixture(params=["sqlite", "postgresql"])
def store(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Store]:
    """A new store of each kind."""
    url = ""
    if request.param == "postgresql":
        url = request.getfixturevalue("postgresql").database()
    with Store.open(url, tmp_path) as store:
        yield store


@pytest.fixture
def sqlite_store(tmp_path: Path) -> Iterator[Store]:
    with Store.open("", tmp_path) as store:
        yield store


@pytest.fixture(scope="module", params=["sqlite", "postgresql"])
def shared_store(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Store]:
    """A store for many examples of one property; each takes an asset of its own."""
    url = ""
    if request.param == "postgresql":
        url = request.getfixturevalue("postgresql").database()
    with Store.open(url, tmp_path_factory.mktemp("shared")) as store:
        yield store
