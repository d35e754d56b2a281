"""The folder through which worker and service talk."""

import json
from pathlib import Path

import pytest

from service.jobs.documents import ProgressCache
from service.jobs.workspace import MOST_POINTS, Convergence, JobFolder, Progress, clear_folders

HALF = Progress(fraction=0.5, phase="noa", evaluations=1200, best_fitness=0.73)


@pytest.fixture
def folder(tmp_path: Path) -> JobFolder:
    folder = JobFolder(tmp_path / "jobs" / "abc")
    folder.make()
    return folder


def test_progress_comes_back_as_it_was_written(folder: JobFolder) -> None:
    assert folder.read_progress() is None
    folder.write_progress(HALF)
    assert folder.read_progress() == HALF
    unknown = Progress(0.0, "preparing", 0, None)
    folder.write_progress(unknown)
    assert folder.read_progress() == unknown


def test_no_half_written_progress_is_ever_read(folder: JobFolder) -> None:
    folder.write_progress(HALF)
    # What a worker leaves that dies in the middle of writing.
    (folder.path / "progress.json.new").write_text('{"fraction": 0.')
    assert folder.read_progress() == HALF
    folder.write_progress(HALF)
    assert [path.name for path in folder.path.iterdir()] == ["progress.json"]
    assert json.loads((folder.path / "progress.json").read_text())["phase"] == "noa"


def test_the_mark_to_stop_is_seen(folder: JobFolder) -> None:
    assert not folder.cancelled
    folder.cancel()
    assert folder.cancelled


def test_made_again_only_the_checkpoint_is_left(folder: JobFolder) -> None:
    folder.write_progress(HALF)
    folder.write_checkpoint({"evaluations": 5})
    folder.cancel()
    folder.make()
    assert not folder.cancelled
    assert folder.read_progress() is None
    assert folder.read_checkpoint() == {"evaluations": 5}


def test_a_checkpoint_is_whole_or_none(folder: JobFolder) -> None:
    assert folder.read_checkpoint() is None
    folder.write_checkpoint({"evaluations": 5})
    # What a worker killed in the middle of writing leaves behind.
    (folder.path / "checkpoint.json.new").write_text('{"evaluations": 6')
    assert folder.read_checkpoint() == {"evaluations": 5}
    for damaged in ('{"evaluations": 6', "[]", ""):
        (folder.path / "checkpoint.json").write_text(damaged)
        assert folder.read_checkpoint() is None


def test_only_folders_of_unfinished_jobs_are_kept(folder: JobFolder) -> None:
    parent = folder.path.parent
    other = JobFolder(parent / "def")
    other.make()
    clear_folders(parent, {"abc"})
    assert [path.name for path in parent.iterdir()] == ["abc"]
    clear_folders(parent, set())
    assert not parent.exists()
    clear_folders(parent, set())


def test_removed_it_is_gone_and_that_is_no_error(folder: JobFolder) -> None:
    folder.remove()
    assert not folder.path.exists()
    folder.cancel()
    folder.remove()
    assert not folder.path.exists()
    assert folder.read_progress() is None


def test_convergence_stays_short_and_keeps_its_ends() -> None:
    told = Convergence([[10, None], [25, 900.0]])
    for number in range(5000):
        told.add(50 + number, 800.0 - 0.1 * number)
    told.add(60, 1.0)  # older than what is there
    told.add(9999, float("inf"))
    assert len(told.points) <= MOST_POINTS
    assert told.points[0] == [25, 900.0]
    assert told.points[-1] == [5049, pytest.approx(300.1)]
    evaluations = [point[0] for point in told.points]
    assert evaluations == sorted(set(evaluations))


def left(words: ProgressCache) -> float | None:
    told = words.get("a")
    assert told is not None
    return told.seconds_left()


def test_the_time_left_follows_the_pace_of_this_attempt() -> None:
    words = ProgressCache()
    for number, fraction in enumerate((0.5, 0.505)):
        words.remember("a", Progress(fraction, "search", 100, 1.0), 1000.0 + 10.0 * number)
        assert left(words) is None
    words.remember("a", Progress(0.6, "search", 100, 1.0), 1020.0)
    assert left(words) == pytest.approx(80.0)
    # Another attempt begins anew, and nobody knows how long the gates take.
    words.remember("a", Progress(0.1, "search", 100, 1.0), 2000.0)
    assert left(words) is None
    words.remember("a", Progress(0.8, "gates", 100, 1.0), 2100.0)
    assert left(words) is None
    assert words.get("b") is None
