"""Results of a night: one for each asset, also when it is computed twice."""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

from service.features.nights.results import NightModel, Nights
from service.store import AuditEntry, Job, Store

NIGHT = "2026-11-22"


def job(number: int, **changes: object) -> Job:
    ended = Job(
        id=f"job-{number}",
        asset="a",
        status="succeeded",
        progress=1.0,
        best_fitness=1.5,
        evaluations=7,
        created_at_us=10,
        started_at_us=10,
        ended_at_us=20,
        error=None,
        model_version=None,
        request={"who": "eva"},
        idempotency_key=None,
        attempts=1,
    )
    return replace(ended, **changes)  # type: ignore[arg-type]


def model(**changes: object) -> NightModel:
    line = AuditEntry(5, "eva", "", "model.activate", "asset a, version {version}")
    found = NightModel("candidate", "passed", {"x": 1}, activate=True, line=line)
    return replace(found, **changes)  # type: ignore[arg-type]


def active(store: Store) -> int | None:
    found = store.models.active("a")
    return None if found is None else found.version


def test_of_many_that_bring_a_result_one_is_kept_with_all_that_belongs_to_it(store: Store) -> None:
    def keep(number: int) -> Job | None:
        return store.part(Nights).keep(NIGHT, job(number), model())

    with ThreadPoolExecutor(8) as threads:
        kept = [one for one in threads.map(keep, range(8)) if one is not None]
    assert [one.model_version for one in kept] == [1]
    assert store.part(Nights).done(NIGHT, ["a", "b"]) == {"a": kept[0]}
    assert store.part(Nights).done("2026-11-23", ["a"]) == {}
    assert [one.version for one in store.models.versions("a")] == [1]
    assert store.jobs.of_asset("a") == kept
    (line,) = store.audit.page().items
    assert line.target == "asset a, version 1"


def test_a_version_becomes_active_in_place_of_the_one_it_was_compared_with(store: Store) -> None:
    versions: Sequence[tuple[str, NightModel, int | None]] = (
        ("1", model(activate=False), None),
        ("2", model(), 2),
        ("3", model(instead_of=2), 3),
        ("4", model(instead_of=2), 3),
        ("5", model(status="rejected", activate=False, instead_of=3), 3),
    )
    for night, found, expected in versions:
        kept = store.part(Nights).keep(night, job(int(night)), found)
        assert kept is not None
        assert kept.model_version == int(night)
        assert active(store) == expected
    assert store.models.active_numbers() == {"a": 3}
    assert [one.version for one in store.models.parts("a", [], 2)] == [4, 5]


def test_a_job_that_failed_counts_as_done_and_a_running_one_as_busy(store: Store) -> None:
    failed = job(1, status="failed", error="no simulation holds")
    kept = store.part(Nights).keep(NIGHT, failed, None)
    assert kept is not None
    assert (kept.status, kept.model_version) == ("failed", None)
    assert store.part(Nights).keep(NIGHT, job(2), model()) is None
    assert store.models.versions("a") == []
    running, _ = store.jobs.add("b", {}, 1)
    assert store.part(Nights).busy(["a", "b"]) == {"b": running}
