"""Files take their places whole, and no link that someone planted leads them elsewhere."""

import os
import stat
from pathlib import Path

import pytest

from service.cli.errors import BadInputError
from service.cli.example import example
from service.files import FileError, replacing


@pytest.mark.parametrize("private", [False, True])
def test_a_link_planted_beside_a_file_is_not_followed(tmp_path: Path, private: bool) -> None:
    victim, out = tmp_path / "victim", tmp_path / "o.csv"
    victim.write_text("mine")
    (tmp_path / "o.csv.part").symlink_to(victim)
    with replacing(out, private=private) as file:
        file.write("a,b\n")
    assert victim.read_text() == "mine"
    assert (out.read_text(), out.is_symlink()) == ("a,b\n", False)
    assert sorted(one.name for one in tmp_path.iterdir()) == ["o.csv", "victim"]


def test_what_an_earlier_end_left_is_no_obstacle(tmp_path: Path) -> None:
    (tmp_path / "o.csv.part").write_text("half of a much longer file")
    with replacing(tmp_path / "o.csv") as file:
        file.write("whole")
    assert (tmp_path / "o.csv").read_text() == "whole"


def test_a_private_file_is_so_from_its_first_byte(tmp_path: Path) -> None:
    before = os.umask(0o022)
    try:
        for private, mode in ((True, 0o600), (False, 0o644)):
            with replacing(tmp_path / "o", private=private):
                part = tmp_path / "o.part"
                assert stat.S_IMODE(part.stat().st_mode) == mode
            assert stat.S_IMODE((tmp_path / "o").stat().st_mode) == mode
    finally:
        os.umask(before)


def test_a_folder_in_the_way_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "o.csv.part").mkdir()
    with (
        pytest.raises(FileError, match=r"o\.csv: cannot be written"),
        replacing(tmp_path / "o.csv") as file,
    ):
        file.write("a")
    assert (tmp_path / "o.csv.part").is_dir(), "it is not ours"


def test_the_example_goes_through_no_link_that_leads_to_no_file(tmp_path: Path) -> None:
    folder = tmp_path / "folder"
    folder.mkdir()
    (folder / "bench.dbc").symlink_to(tmp_path / "victim")
    with pytest.raises(BadInputError, match="is there already"):
        example(folder)
    assert not (tmp_path / "victim").exists()
