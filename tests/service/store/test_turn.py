"""The threads that write take turns."""

import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
from processes import wait_until

from service.store import Store, StoreUnavailableError
from service.store.database import Database, Turn

PATIENCE_S = 60.0


@pytest.fixture
def database(tmp_path: Path) -> Iterator[Database]:
    with Store.open("", tmp_path) as store:
        yield store._database


def queued(turn: Turn, count: int) -> None:
    wait_until(lambda: len(turn._waiting) == count, PATIENCE_S, "they wait", 0.001)


def test_who_waits_gets_the_right_to_write_before_who_asks_once_more(database: Database) -> None:
    """A thread that computes one rollup after the other must not keep live samples waiting."""
    order: list[str] = []

    def write(name: str) -> None:
        with database.writing(PATIENCE_S):
            order.append(name)

    for _ in range(20):
        order.clear()
        with database.writing(PATIENCE_S):
            others = [threading.Thread(target=write, args=(name,)) for name in ("first", "second")]
            for number, other in enumerate(others, 1):
                other.start()
                queued(database._turn, number)
        write("once more")
        for other in others:
            other.join()
        assert order == ["first", "second", "once more"]


def test_who_gives_up_waiting_holds_up_nobody(database: Database) -> None:
    turn = database._turn
    with (
        database.writing(PATIENCE_S),
        pytest.raises(StoreUnavailableError, match="busy with another write"),
        database.writing(0.05),
    ):
        pass
    assert not turn._waiting
    with database.writing(0.05):
        pass


def test_a_turn_is_never_held_by_two_nor_lost_when_many_give_up() -> None:
    turn, inside, times = Turn(), threading.Lock(), []

    def take_turns() -> None:
        for number in range(200):
            if turn.acquire(0.0 if number % 3 else 0.001 * (number % 7)):
                assert inside.acquire(blocking=False), "two hold the turn"
                times.append(number)
                inside.release()
                turn.release()

    threads = [threading.Thread(target=take_turns) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert times
    assert turn.acquire(0.0), "given back"
