"""The folder through which worker and service talk."""

import json
from pathlib import Path

import pytest

from service.jobs.workspace import JobFolder, Progress

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


def test_made_again_it_is_empty(folder: JobFolder) -> None:
    folder.write_progress(HALF)
    folder.cancel()
    folder.make()
    assert not folder.cancelled
    assert folder.read_progress() is None


def test_removed_it_is_gone_and_that_is_no_error(folder: JobFolder) -> None:
    folder.remove()
    assert not folder.path.exists()
    folder.cancel()
    folder.remove()
    assert not folder.path.exists()
    assert folder.read_progress() is None
