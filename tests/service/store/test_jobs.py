from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from postgresql import PostgreSQL
from sqlalchemy import insert

from service.store import ActiveJobError, AuditEntry, Store, StoreUnavailableError
from service.store.tables import AssetStateRow


def test_a_job_lives_from_queued_to_its_end(store: Store) -> None:
    job, created = store.jobs.add("a", {"windows": "auto"}, 10)
    assert created
    assert (job.status, job.progress, job.attempts) == ("queued", 0.0, 0)
    running = store.jobs.update(
        job.id, only_if=["queued"], status="running", started_at_us=11, attempts=1
    )
    assert running is not None
    assert running == store.jobs.get(job.id)
    assert (running.status, running.started_at_us, running.attempts) == ("running", 11, 1)
    store.jobs.update(job.id, progress=0.5, best_fitness=0.7, evaluations=900)
    done = store.jobs.update(
        job.id, status="succeeded", progress=1.0, ended_at_us=20, model_version=2
    )
    assert done is not None
    assert (done.best_fitness, done.evaluations, done.model_version) == (0.7, 900, 2)
    assert done.request == {"windows": "auto"}
    assert store.jobs.unfinished() == []
    assert store.jobs.of_asset("a") == [done]
    assert store.jobs.of_asset("b") == []
    assert store.jobs.get("no such") is None


def test_a_job_ends_once(store: Store) -> None:
    job, _ = store.jobs.add("a", {}, 1)
    store.jobs.update(job.id, status="running")
    ends = [("succeeded", n) if n % 2 else ("cancelled", n) for n in range(16)]
    with ThreadPoolExecutor(8) as pool:
        changed = list(
            pool.map(lambda end: store.jobs.update(job.id, status=end[0], ended_at_us=end[1]), ends)
        )
    winners = [one for one in changed if one is not None]
    assert len(winners) == 1
    assert store.jobs.get(job.id) == winners[0]
    assert store.jobs.update(job.id, progress=0.1) is None
    assert store.jobs.update("no such", progress=0.1) is None


def test_one_unfinished_job_per_asset(store: Store) -> None:
    first, _ = store.jobs.add("a", {}, 1)
    store.jobs.add("b", {}, 1)
    with pytest.raises(ActiveJobError, match="already queued or running") as caught:
        store.jobs.add("a", {}, 2)
    assert caught.value.job_id == first.id
    store.jobs.update(first.id, status="failed", error="solver")
    second, created = store.jobs.add("a", {}, 3)
    assert created
    assert [job.id for job in store.jobs.of_asset("a")] == [second.id, first.id]


def test_the_same_key_gives_the_same_job_even_when_it_has_ended(store: Store) -> None:
    first, _ = store.jobs.add("a", {}, 1, "key")
    assert store.jobs.add("a", {}, 2, "key") == (first, False)
    ended = store.jobs.update(first.id, status="failed")
    assert store.jobs.add("a", {}, 3, "key") == (ended, False)
    other, created = store.jobs.add("b", {}, 3, "key")
    assert created
    assert other.id != first.id
    store.jobs.update(other.id, status="succeeded")
    assert store.jobs.add("b", {}, 4)[1]


def test_of_many_that_ask_at_once_one_gets_the_job(store: Store) -> None:
    def ask(_: int) -> bool:
        try:
            return store.jobs.add("a", {}, 1)[1]
        except ActiveJobError:
            return False

    with ThreadPoolExecutor(8) as pool:
        assert list(pool.map(ask, range(16))).count(True) == 1


def test_unfinished_jobs_are_found_after_a_restart_and_taken_up_again(tmp_path: Path) -> None:
    with Store.open("", tmp_path) as store:
        running, _ = store.jobs.add("a", {"seed": 1}, 1)
        store.jobs.update(running.id, status="running", attempts=1)
        queued, _ = store.jobs.add("b", {}, 2)
        done, _ = store.jobs.add("c", {}, 3)
        store.jobs.update(done.id, status="succeeded")
    with Store.open("", tmp_path) as store:
        assert [job.id for job in store.jobs.unfinished()] == [running.id, queued.id]
        again = store.jobs.update(running.id, only_if=["running"], status="queued")
        assert again is not None
        assert (again.status, again.request, again.attempts) == ("queued", {"seed": 1}, 1)
        assert store.jobs.update(running.id, only_if=["running"], status="queued") is None


def test_an_asset_state_is_replaced_and_kept(tmp_path: Path) -> None:
    with Store.open("", tmp_path) as store:
        assert store.states.load("a") is None
        store.states.save("a", {"revolutions": 1.0})
        store.states.save("a", {"revolutions": 2.5, "temperatures_c": [1.0] * 13})
        store.states.save("b", {})
    with Store.open("", tmp_path) as store:
        assert store.states.load("a") == {"revolutions": 2.5, "temperatures_c": [1.0] * 13}
        assert store.states.load("b") == {}


@pytest.mark.wires
def test_cells_keep_states_next_to_each_other(
    postgresql: PostgreSQL, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What is written with lines of the audit trail, which is everyone's, waits for its turn."""
    monkeypatch.setattr("service.store.asset_states._PATIENCE_S", 0.2)
    url = postgresql.database()
    line = AuditEntry(1, "eva", "", "grease.renew", "asset b")
    with Store.open(url, tmp_path / "one") as one, Store.open(url, tmp_path / "other") as other:
        with one._database.writing_samples() as connection:
            connection.execute(insert(AssetStateRow).values(asset="a", document={"by": "one"}))
            other.states.save("b", {"by": "other"})
            assert other.states.load("b") == {"by": "other"}
            with pytest.raises(StoreUnavailableError):
                other.states.save("b", {"by": "other, later"}, [line])
        assert other.states.load_all() == {"a": {"by": "one"}, "b": {"by": "other"}}
        other.states.save("b", {"by": "other, later"}, [line])
        assert [entry.target for entry in one.audit.page().items] == ["asset b"]


def test_states_of_many_assets_are_kept_at_once_to_the_last_bit(store: Store) -> None:
    numbers = [0.1 + 0.2, 1e-300, -0.0, 1.7976931348623157e308]
    documents = {f"m{n}": {"numbers": numbers, "n": n, "none": None} for n in range(300)}
    store.states.save("m7", {"old": True})
    store.states.save_all(documents)
    store.states.save_all({})
    assert store.states.load_all() == documents
    kept = store.states.load("m7")
    assert kept is not None
    assert [value.hex() for value in kept["numbers"]] == [value.hex() for value in numbers]
