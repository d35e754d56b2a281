"""The page writes the file that a person would: comments stay, and nothing else changes."""

import contextlib
import tomllib
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from service.features.commissioning.edited_file import with_tables
from service.features.commissioning.file_versions import (
    FileChangedError,
    revision_of,
    save,
    versions,
)
from service.site.configuration import SettingsError
from service.site.page_sources import source_from_page

EXAMPLE = Path(__file__).parents[4] / "deploy/bearing-twin.example.toml"
_VALUES = st.one_of(st.booleans(), st.integers(-999, 999), st.text(max_size=8))
_TABLES = st.dictionaries(
    st.text("abcxyz_ .\"'", min_size=1, max_size=6),
    st.recursive(
        _VALUES, lambda inner: st.dictionaries(st.text("ab", min_size=1), inner), max_leaves=6
    ),
    max_size=6,
)


def test_one_changed_key_changes_one_line() -> None:
    text = EXAMPLE.read_text(encoding="utf-8")
    read = tomllib.loads(text)
    source = read["sources"][0] | {"port": 502}
    changed = with_tables(text, [source], [read["assets"][0]])
    pairs = zip(text.splitlines(), changed.splitlines(), strict=True)
    assert [(before, after) for before, after in pairs if before != after] == [
        (
            "port = 5020                 # 502 on most devices",
            "port = 502                 # 502 on most devices",
        )
    ]


@given(sources=st.lists(_TABLES, max_size=3), later=_TABLES)
def test_what_is_written_says_what_was_meant(
    sources: list[dict[str, Any]], later: dict[str, Any]
) -> None:
    named = [one | {"name": f"s{number}"} for number, one in enumerate(sources)]
    text = with_tables("# first\n[service]\nport = 1\n", named, [])
    assert tomllib.loads(text).get("sources", []) == named
    again = with_tables(text, [later | {"name": "s0"}], [later | {"id": "a"}])
    read = tomllib.loads(again)
    assert read["sources"] == [later | {"name": "s0"}, *named[1:]]
    assert read["assets"] == [later | {"id": "a"}]
    assert (read["service"], again.startswith("# first\n")) == ({"port": 1}, True)


def test_every_version_can_be_had_again_also_one_by_hand(tmp_path: Path) -> None:
    file, data = tmp_path / "bench.toml", tmp_path / "var"
    base: dict[str, Any] = {"who": "admin", "what": "test", "now_us": 1}
    assert save(file, data, "a = 1\n", based_on=revision_of(""), **base)
    assert save(file, data, "a = 1\n", based_on=revision_of("a = 1\n"), **base) is None
    file.write_text("a = 2\n")
    with pytest.raises(FileChangedError, match="changed meanwhile"):
        save(file, data, "a = 3\n", based_on=revision_of("a = 1\n"), **base)
    assert file.read_text() == "a = 2\n"
    file.chmod(0o600)
    save(file, data, "a = 3\n", based_on=revision_of("a = 2\n"), **base)
    assert file.stat().st_mode & 0o777 == 0o600
    kept = [(one.number, one.who, one.text) for one in versions(data)]
    assert kept == [
        (4, "admin", "a = 3\n"),
        (3, "by hand", "a = 2\n"),
        (2, "admin", "a = 1\n"),
        (1, "by hand", ""),
    ]


def test_of_many_changes_of_one_text_one_is_saved_and_the_others_are_refused(
    tmp_path: Path,
) -> None:
    file, data = tmp_path / "bench.toml", tmp_path / "var"

    def change(number: int) -> bool:
        with contextlib.suppress(FileChangedError):
            text, base = f"a = {number}\n", revision_of("")
            save(file, data, text, based_on=base, who="admin", what="test", now_us=number)
            return True
        return False

    with ThreadPoolExecutor(8) as threads:
        saved = list(threads.map(change, range(32)))
    assert saved.count(True) == 1
    assert file.read_text() == f"a = {saved.index(True)}\n"
    assert [one.number for one in versions(data)] == [2, 1]


CAN = {"name": "c", "driver": "can", "interface": "socketcand", "channel": "can0", "dbc": "b.dbc"}


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ({"name": "r", "driver": "replay", "file": "/etc/passwd"}, "source.driver = 'replay'"),
        ({"name": "m", "driver": "modbus-rtu", "device": "/etc/passwd"}, "expected a path in /dev"),
        ({"name": "m", "driver": "modbus-rtu", "device": "/dev/../etc/x"}, "expected a path in"),
        (CAN | {"dbc": "../../etc/shadow"}, "source.dbc = '../../etc/shadow'"),
        (CAN | {"dbc": "/etc/passwd"}, "source.dbc"),
        (CAN | {"interface": "slcan", "channel": "spy:///dev/tty?file=/tmp/x"}, "source.channel"),
        (CAN | {"interface": "virtual"}, "source.interface = 'virtual'"),
        (CAN | {"plugin": "x"}, "source.plugin: expected in the file alone"),
    ],
)
def test_the_page_names_no_files_of_the_machine(
    table: dict[str, Any], words: str, tmp_path: Path
) -> None:
    with pytest.raises(SettingsError, match=words.replace(".", r"\.")):
        source_from_page(table, tmp_path)
