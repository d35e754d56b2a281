"""The clock of a cell is set at one moment, and says by how much; across a restart too."""

import json
from pathlib import Path

import pytest

from service.cell.cell_clock import CellClock
from service.clock import ProcessClock

HOUR_US = 3_600_000_000
START_US = 1_790_000_000_000_000
STEPS_US = (-HOUR_US, HOUR_US, -HOUR_US // 6, 720 * HOUR_US, -720 * HOUR_US)


class Machine:
    """A machine whose system clock is set by hand."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.up_s, self.set_us = folder, 1000.0, 0
        self.boot_id = "first"

    def begin(self, rate: float = 1.0) -> CellClock:
        """Start a run of a cell."""
        machine = self

        class System(ProcessClock):
            def now_us(self) -> int:
                return START_US + machine.set_us + round(machine.up_s * rate * 1e6)

        return CellClock(System(rate), self.folder, lambda: self.up_s, self.boot_id)


class Cell:
    """What is moved of a run."""

    def __init__(self, clock: CellClock) -> None:
        self.clock, self.live, self.kept = clock, list[int](), list[int | None]()

    def load(self) -> "Cell":
        self.kept.append(self.clock.since_last_run_us())
        self.clock.move_with(self.live.append)
        self.clock.keep_mark()
        return self


@pytest.fixture
def machine(tmp_path: Path) -> Machine:
    return Machine(tmp_path)


@pytest.mark.parametrize("step_us", STEPS_US)
@pytest.mark.parametrize("rate", [1.0, 60.0])
def test_it_is_set_at_one_moment_and_says_by_how_much(
    machine: Machine, step_us: int, rate: float
) -> None:
    clock = machine.begin(rate)
    cell = Cell(clock).load()
    before_us = clock.now_us()
    machine.up_s += 2.0
    machine.set_us += step_us
    assert clock.now_us() == before_us + round(2e6 * rate), "until then it goes on"
    clock.follow()
    assert cell.live == [step_us]
    assert clock.now_us() == before_us + round(2e6 * rate) + step_us
    clock.follow()
    assert cell.live == [step_us], "once"


def test_what_a_time_server_corrects_moves_nothing(machine: Machine) -> None:
    clock = machine.begin()
    cell = Cell(clock).load()
    for _ in range(10):
        machine.set_us += 400_000
        clock.follow()
    assert cell.live == []
    assert clock.now_us() == START_US + machine.set_us + 1_000_000_000
    machine.set_us -= HOUR_US
    clock.follow()
    assert cell.live == [-HOUR_US], "the corrections are not added to it"


def test_a_suspended_machine_has_not_set_its_clock(machine: Machine) -> None:
    clock = machine.begin()
    cell = Cell(clock).load()
    machine.up_s += 7200.0
    clock.follow()
    assert cell.live == []


@pytest.mark.parametrize("step_us", STEPS_US)
def test_what_was_set_between_two_runs_is_found(machine: Machine, step_us: int) -> None:
    Cell(machine.begin()).load()
    machine.up_s += 600.0
    machine.set_us += step_us
    clock = machine.begin()
    assert clock.now_us() == START_US + 1_600_000_000 + step_us, "samples have the right time"
    assert clock.since_last_run_us() == step_us
    cell = Cell(clock).load()
    assert (cell.kept, cell.live) == ([step_us], []), "also if a first cell could not begin"
    assert Cell(machine.begin()).load().kept == [0], "once"


def test_what_is_set_before_all_is_loaded_adds_up(machine: Machine) -> None:
    Cell(machine.begin()).load()
    machine.set_us += HOUR_US
    clock = machine.begin()
    machine.set_us += HOUR_US
    clock.follow()
    assert machine.begin().since_last_run_us() == 2 * HOUR_US, "it ended before it had moved them"
    assert clock.since_last_run_us() == 2 * HOUR_US
    machine.set_us -= HOUR_US
    clock.follow()
    moves = list[int]()
    clock.move_with(moves.append)
    assert moves == [-HOUR_US], "set while it was loaded"


def test_what_is_set_after_a_cell_has_left_is_found_by_the_next(machine: Machine) -> None:
    cell = Cell(machine.begin()).load()
    cell.clock.leave()
    machine.set_us += HOUR_US
    cell.clock.follow()
    cell.clock.keep_mark()
    assert cell.live == []
    assert Cell(machine.begin()).load().kept == [HOUR_US]


def test_small_corrections_of_months_are_no_step_at_the_next_start(machine: Machine) -> None:
    clock = Cell(machine.begin()).load().clock
    for _ in range(10):
        machine.set_us += 400_000
        clock.follow()
        clock.keep_mark()
    assert Cell(machine.begin()).load().kept == [0]


@pytest.mark.parametrize(
    "change",
    [
        {"boot_id": "second"},
        {"rate": 2.0},
        {"offset_us": "yesterday"},
        {"offset_us": None},
        None,
    ],
)
def test_of_another_start_of_the_machine_nothing_is_known(
    machine: Machine, change: dict[str, object] | None
) -> None:
    """A clock without a battery goes on where it was; the time server puts it right later."""
    Cell(machine.begin()).load()
    mark = machine.folder / "clock_mark.json"
    kept = json.loads(mark.read_text())
    mark.write_text("{" if change is None else json.dumps(kept | change))
    machine.set_us += HOUR_US
    clock = machine.begin()
    assert not clock.knows_last_run
    machine.set_us += HOUR_US
    clock.follow()
    assert Cell(clock).load().kept == [None]
    machine.set_us += HOUR_US
    after = machine.begin()
    assert after.knows_last_run
    assert Cell(after).load().kept == [HOUR_US], "it is known again"


def test_a_mark_that_cannot_be_kept_is_kept_later(machine: Machine) -> None:
    mark = machine.folder / "clock_mark.json"
    mark.mkdir()
    clock = machine.begin()
    cell = Cell(clock).load()
    machine.set_us += HOUR_US
    clock.follow()
    assert cell.live == [HOUR_US]
    clock.keep_mark()
    mark.rmdir()
    clock.keep_mark()
    assert Cell(machine.begin()).load().kept == [0]


def test_a_cell_that_is_given_up_while_it_is_made_moves_nothing(machine: Machine) -> None:
    Cell(machine.begin()).load()
    machine.set_us += HOUR_US
    clock = machine.begin()
    cell = Cell(clock)
    assert clock.since_last_run_us() == HOUR_US
    clock.leave()
    clock.move_with(cell.live.append)
    clock.keep_mark()
    assert cell.live == []
    assert Cell(machine.begin()).load().kept == [HOUR_US]


def test_what_is_set_while_a_cell_is_made_moves_what_it_has_made(machine: Machine) -> None:
    """Of a machine that has just been started: its time server is right now."""
    clock, moves = machine.begin(), list[int]()
    machine.set_us += HOUR_US
    clock.follow()
    assert clock.since_last_run_us() is None
    machine.set_us += HOUR_US
    clock.follow()
    clock.move_with(moves.append)
    assert moves == [HOUR_US]


def test_the_mark_waits_for_what_was_moved(machine: Machine) -> None:
    """Else times that a power cut keeps from the disk would never be moved."""
    Cell(machine.begin()).load()
    clock, kept = machine.begin(), list[bool]()
    clock.move_with(lambda by_us: None, lambda: bool(kept))
    machine.set_us += HOUR_US
    clock.follow()
    clock.keep_mark()
    assert machine.begin().since_last_run_us() == HOUR_US
    kept.append(True)
    clock.keep_mark()
    assert machine.begin().since_last_run_us() == 0
