from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from service.store import ActiveJobError, Store


def test_a_job_lives_from_queued_to_its_end(store: Store) -> None:
    job, created = store.add_job("a", {"windows": "auto"}, 10)
    assert created
    assert (job.status, job.progress, job.attempts) == ("queued", 0.0, 0)
    running = store.update_job(
        job.id, only_if=["queued"], status="running", started_at_us=11, attempts=1
    )
    assert running is not None
    assert running == store.job(job.id)
    assert (running.status, running.started_at_us, running.attempts) == ("running", 11, 1)
    store.update_job(job.id, progress=0.5, best_fitness=0.7, evaluations=900)
    done = store.update_job(
        job.id, status="succeeded", progress=1.0, ended_at_us=20, model_version=2
    )
    assert done is not None
    assert (done.best_fitness, done.evaluations, done.model_version) == (0.7, 900, 2)
    assert done.request == {"windows": "auto"}
    assert store.unfinished_jobs() == []
    assert store.jobs("a") == [done]
    assert store.jobs("b") == []
    assert store.job("no such") is None


def test_a_job_ends_once(store: Store) -> None:
    job, _ = store.add_job("a", {}, 1)
    store.update_job(job.id, status="running")
    ends = [("succeeded", n) if n % 2 else ("cancelled", n) for n in range(16)]
    with ThreadPoolExecutor(8) as pool:
        changed = list(
            pool.map(lambda end: store.update_job(job.id, status=end[0], ended_at_us=end[1]), ends)
        )
    winners = [one for one in changed if one is not None]
    assert len(winners) == 1
    assert store.job(job.id) == winners[0]
    assert store.update_job(job.id, progress=0.1) is None
    assert store.update_job("no such", progress=0.1) is None


def test_one_unfinished_job_per_asset(store: Store) -> None:
    first, _ = store.add_job("a", {}, 1)
    store.add_job("b", {}, 1)
    with pytest.raises(ActiveJobError, match="already queued or running") as caught:
        store.add_job("a", {}, 2)
    assert caught.value.job_id == first.id
    store.update_job(first.id, status="failed", error="solver")
    second, created = store.add_job("a", {}, 3)
    assert created
    assert [job.id for job in store.jobs("a")] == [second.id, first.id]


def test_the_same_key_gives_the_same_job_even_when_it_has_ended(store: Store) -> None:
    first, _ = store.add_job("a", {}, 1, "key")
    assert store.add_job("a", {}, 2, "key") == (first, False)
    ended = store.update_job(first.id, status="failed")
    assert store.add_job("a", {}, 3, "key") == (ended, False)
    other, created = store.add_job("b", {}, 3, "key")
    assert created
    assert other.id != first.id
    store.update_job(other.id, status="succeeded")
    assert store.add_job("b", {}, 4)[1]


def test_of_many_that_ask_at_once_one_gets_the_job(store: Store) -> None:
    def ask(_: int) -> bool:
        try:
            return store.add_job("a", {}, 1)[1]
        except ActiveJobError:
            return False

    with ThreadPoolExecutor(8) as pool:
        assert list(pool.map(ask, range(16))).count(True) == 1


def test_unfinished_jobs_are_found_after_a_restart_and_taken_up_again(tmp_path: Path) -> None:
    with Store.open("", tmp_path) as store:
        running, _ = store.add_job("a", {"seed": 1}, 1)
        store.update_job(running.id, status="running", attempts=1)
        queued, _ = store.add_job("b", {}, 2)
        done, _ = store.add_job("c", {}, 3)
        store.update_job(done.id, status="succeeded")
    with Store.open("", tmp_path) as store:
        assert [job.id for job in store.unfinished_jobs()] == [running.id, queued.id]
        again = store.update_job(running.id, only_if=["running"], status="queued")
        assert again is not None
        assert (again.status, again.request, again.attempts) == ("queued", {"seed": 1}, 1)
        assert store.update_job(running.id, only_if=["running"], status="queued") is None


def test_an_asset_state_is_replaced_and_kept(tmp_path: Path) -> None:
    with Store.open("", tmp_path) as store:
        assert store.load_asset_state("a") is None
        store.save_asset_state("a", {"revolutions": 1.0})
        store.save_asset_state("a", {"revolutions": 2.5, "temperatures_c": [1.0] * 13})
        store.save_asset_state("b", {})
    with Store.open("", tmp_path) as store:
        assert store.load_asset_state("a") == {"revolutions": 2.5, "temperatures_c": [1.0] * 13}
        assert store.load_asset_state("b") == {}
