"""How far the runs of a night are: in the store, and put together as callers see them."""

from dataclasses import replace

from service.features.nights.documents import LOST_AFTER_US, NightDocument, nights_of
from service.features.nights.tables import KEPT_US, FleetRun, FleetRuns
from service.store import Store

RUN = FleetRun(
    id="a",
    night="2026-11-22",
    chosen="all assets",
    executor="process",
    workers=2,
    workers_lost=1,
    asked=100,
    identified=40,
    warm_starts=30,
    refused=5,
    done_before=0,
    skipped=10,
    without_new_data=4,
    failed=2,
    processor_s=20.0,
    began_us=KEPT_US,
    told_us=KEPT_US + 10,
    ended_us=None,
    problems={"m-1": "3 workers died of it"},
)


def test_a_run_replaces_what_it_said_before_and_old_ones_go(store: Store) -> None:
    for run in (RUN, replace(RUN, id="b", began_us=KEPT_US + 1), replace(RUN, identified=41)):
        store.part(FleetRuns).save(run)
    assert [(run.id, run.identified) for run in store.part(FleetRuns).all()] == [
        ("b", 40),
        ("a", 41),
    ]
    store.part(FleetRuns).save(replace(RUN, id="c", began_us=2 * KEPT_US + 1))
    assert [run.id for run in store.part(FleetRuns).all()] == ["c", "b"]


def test_the_runs_of_a_night_are_shown_as_one() -> None:
    """A killed run and the one that went on with its work; another night, another family."""
    going_on = replace(
        RUN,
        id="b",
        done_before=40,
        identified=45,
        warm_starts=45,
        refused=1,
        skipped=12,
        failed=3,
        processor_s=14.0,
        began_us=KEPT_US + 100,
        told_us=KEPT_US + 200,
        ended_us=KEPT_US + 200,
    )
    others = [replace(RUN, night="2026-11-21"), replace(RUN, chosen="family old")]
    nights = nights_of([going_on, RUN, *others])
    assert [len(night) for night in nights] == [2, 1, 1]
    found = NightDocument.of(nights[0], going_on.told_us)
    assert (found.state, found.runs, found.workers_lost) == ("ended", 2, 2)
    assert (found.done, found.warm_starts, found.refused, found.left) == (85, 75, 6, 0)
    assert (found.failed, found.skipped) == (3, 12)
    assert found.processor_seconds_per_machine == 34.0 / 85
    assert (found.began_at, found.ended_at) == ("1971-02-05T00:00:00.000Z",) * 2


def test_a_run_that_is_silent_is_lost_and_one_that_left_work_was_stopped() -> None:
    def state(now_us: int, **changes: object) -> str:
        return NightDocument.of([replace(RUN, **changes)], now_us).state  # type: ignore[arg-type]

    assert state(RUN.told_us + LOST_AFTER_US - 1) == "running"
    assert state(RUN.told_us + LOST_AFTER_US) == "lost"
    assert state(RUN.told_us, ended_us=RUN.told_us) == "stopped"
    assert state(RUN.told_us, ended_us=RUN.told_us, asked=52) == "ended"
    nothing = NightDocument.of([replace(RUN, identified=0)], RUN.told_us)
    assert nothing.processor_seconds_per_machine is None
