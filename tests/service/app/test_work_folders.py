"""Where kernels and temporary files go."""

import os
import tempfile
from pathlib import Path

import pytest

from service.app.work_folders import use_work_folders

NAME = "NUMBA_CACHE_DIR"


def kept() -> str | None:
    return os.environ.get(NAME)


def test_kernels_stay_where_they_are_while_that_can_be_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    usual = tmp_path / "cache" / "kernels"
    monkeypatch.setenv(NAME, str(usual))
    use_work_folders(tmp_path / "data")
    assert kept() == str(usual)


def test_kernels_that_cannot_be_kept_elsewhere_are_kept_beside_the_store(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    no_folder = tmp_path / "file"
    no_folder.touch()
    monkeypatch.setenv(NAME, str(no_folder / "kernels"))
    use_work_folders(tmp_path / "data")
    assert kept() == str(tmp_path / "data" / "kernels")


@pytest.mark.parametrize("refused", [True, False])
def test_a_package_that_cannot_be_written_keeps_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, refused: bool
) -> None:
    monkeypatch.delenv(NAME, raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", "" if refused else str(tmp_path))
    monkeypatch.setattr("os.access", lambda path, mode: not refused)
    use_work_folders(tmp_path / "data")
    assert kept() == (str(tmp_path / "data" / "kernels") if refused else None)


def test_temporary_files_without_a_folder_go_beside_the_store(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TMPDIR", "")
    monkeypatch.setattr(tempfile, "tempdir", None)
    monkeypatch.setattr(tempfile, "_candidate_tempdir_list", list)
    use_work_folders(tmp_path)
    assert os.environ["TMPDIR"] == str(tmp_path)
