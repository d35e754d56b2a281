"""What only the PostgreSQL store does."""

from pathlib import Path

import pytest
from postgresql import PostgreSQL, running_postgresql
from sqlalchemy import create_engine
from sqlalchemy.engine import make_url

from adapters.samples import Sample
from service.store import Store, StoreError, StoreUnavailableError
from service.store.database import SampleColumns
from service.store.postgresql import PARTITION_US


def sample(time_us: int, value: float = 1.0) -> Sample:
    return Sample("a", "x", time_us, value, 192, time_us)


def test_tables_are_made_when_asked_for_and_not_by_a_service(
    postgresql: PostgreSQL, tmp_path: Path
) -> None:
    url = postgresql.database(empty=True)
    with pytest.raises(StoreError, match=r"service\.database_url.*run 'bearing-twin db upgrade'"):
        Store.open(url, tmp_path)
    with Store.open(url, tmp_path, migrate=True) as store:
        assert store.samples.write([sample(1)]) == (1, 0)
    with Store.open(url, tmp_path) as store:
        assert store.samples.write([sample(1)]) == (0, 1)


def test_another_programs_tables_are_left_alone(postgresql: PostgreSQL, tmp_path: Path) -> None:
    url = postgresql.database(empty=True)
    engine = create_engine(make_url(url).set(drivername="postgresql+psycopg"))
    with engine.begin() as connection:
        connection.exec_driver_sql("CREATE TABLE recipes (cake text)")
    engine.dispose()
    with pytest.raises(StoreError, match="holds the tables of another program"):
        Store.open(url, tmp_path, migrate=True)


def test_samples_lie_in_partitions_made_as_needed(postgresql: PostgreSQL, tmp_path: Path) -> None:
    with Store.open(postgresql.database(), tmp_path) as store:
        times = [0, PARTITION_US - 1, PARTITION_US, 700 * PARTITION_US]
        assert store.samples.write([sample(t) for t in times]) == (4, 0)
        assert store.samples.write([sample(t) for t in times]) == (0, 4)
        with store._database.reading() as connection:
            names = connection.exec_driver_sql(
                "SELECT inhrelid::regclass::text, "
                "(SELECT count(*) FROM samples WHERE tableoid = inhrelid) "
                "FROM pg_inherits WHERE inhparent = 'samples'::regclass ORDER BY 1"
            ).all()
            plan = connection.exec_driver_sql(
                f"EXPLAIN SELECT * FROM samples WHERE time_us < {PARTITION_US}"
            ).all()
        assert names == [("samples_p0", 2), ("samples_p1", 1), ("samples_p700", 1)]
        assert not any("samples_p1" in line for (line,) in plan), "others are not looked at"
        found = store.samples.read("a", None, 0, 2**62, 10)
        assert [one.time_us for one in found] == times


def test_a_partition_of_a_batch_that_failed_is_made_again(
    postgresql: PostgreSQL, tmp_path: Path
) -> None:
    class LaterError(Exception):
        pass

    def write_and_fail(store: Store, channel_id: int) -> None:
        with store._database.writing() as connection:
            columns = SampleColumns([channel_id], [5], [1.0], [192], [5])
            assert store._database.dialect.upsert_samples(connection, columns) == 1
            raise LaterError

    with Store.open(postgresql.database(), tmp_path) as store:
        store.samples.write([sample(PARTITION_US)])
        with store._database.reading() as connection:
            channel_id = connection.exec_driver_sql("SELECT min(id) FROM channels").scalar_one()
        with pytest.raises(LaterError):
            write_and_fail(store, channel_id)
        assert store.samples.write([sample(5)]) == (1, 0)


@pytest.mark.wires
def test_a_server_that_is_away_is_no_answer_in_time_and_is_found_again(tmp_path: Path) -> None:
    with running_postgresql() as server, Store.open(server.database(), tmp_path) as store:
        assert store.samples.write([sample(1)]) == (1, 0)
        server.stop()
        for _ in range(2):
            with pytest.raises(StoreUnavailableError) as caught:
                store.samples.write([sample(2)], 1.0)
            assert "\n" not in str(caught.value)
        with pytest.raises(StoreUnavailableError):
            store.samples.read("a", None, 0, 9, 9)
        server.start()
        assert store.samples.write([sample(1), sample(2)]) == (1, 1)
        assert [one.time_us for one in store.samples.read("a", None, 0, 9, 9)] == [1, 2]


def test_without_a_server_the_error_is_one_line_without_the_password(tmp_path: Path) -> None:
    with pytest.raises(StoreError, match=r"service\.database_url = .*connection") as caught:
        Store.open("postgresql://u:secret@127.0.0.1:1/d", tmp_path)
    assert "\n" not in str(caught.value)
    assert "secret" not in str(caught.value)
