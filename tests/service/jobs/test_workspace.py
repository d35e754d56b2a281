"""The folder through which worker and service talk."""

import json
from pathlib import Path

import pytest

from service.jobs.workspace import JobFolder, Progress, clear_folders

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
