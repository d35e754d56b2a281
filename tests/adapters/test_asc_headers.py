"""Dates and number bases of ASC logs: understood, or refused in one line; never another time."""

from datetime import UTC, datetime
from pathlib import Path

import pytest

from adapters.configuration import ConfigurationError
from adapters.drivers.replay.can_logs import open_log

DATE = "date Fri Mar 20 08:00:00.000 2026"
BASE = "base hex  timestamps absolute"
FIRST, SECOND = (f"   {k}.000000 1  100             Rx   d 2 12 3{k}" for k in (1, 2))
EXPECTED = "expected one such as 'Fri Mar 20 08:00:00.000 2026'"


def read(
    tmp_path: Path, *lines: str, encoding: str = "utf-8", needs_dates: bool = True
) -> list[tuple[datetime, str]]:
    """Give local time and data of each frame of a log."""
    path = tmp_path / "run.asc"
    path.write_text("\n".join([*lines, ""]), encoding=encoding)
    with open_log(path, needs_dates=needs_dates) as log:
        return [
            (datetime.fromtimestamp(one.timestamp, UTC).astimezone(), one.data.hex()) for one in log
        ]


def local(text: str) -> datetime:
    return datetime.fromisoformat(text).astimezone()


@pytest.mark.parametrize(
    ("date", "moment"),
    [
        ("Fri Mar 20 08:00:00.000 2026", "2026-03-20T08:00:01"),
        ("Fri Mar 20 08:00:00.123456789 2026", "2026-03-20T08:00:01.123456"),
        ("Mit Dez 3 08:00:00.000 2025", "2025-12-03T08:00:01"),
        ("Mi. Dez. 03 08:00:00 2025", "2025-12-03T08:00:01"),
        ("Die Mrz 3 08:00:00 2026", "2026-03-03T08:00:01"),
        ("Dienstag März 3 08:00:00 2026", "2026-03-03T08:00:01"),
        ("Die M\xe4r 3 08:00:00 2026", "2026-03-03T08:00:01"),
        ("Son Okt 4 08:00:00 2026", "2026-10-04T08:00:01"),
        ("Mai 3 08:00:00 2026", "2026-05-03T08:00:01"),
        ("Thursday December 31 11:59:59 pm 2026", "2027-01-01T00:00:00"),
        ("Thu Dec 31 12:00:00.000 AM 2026", "2026-12-31T00:00:01"),
        ("Fri Mar 20 8:5:3 2026", "2026-03-20T08:05:04"),
        ("Wed Dec 31 19:00:00.0 1969", "1969-12-31T19:00:01"),
        ("2026-03-20 08:00:00.250", "2026-03-20T08:00:01.250"),
        ("2026-03-20T08:00:00", "2026-03-20T08:00:01"),
    ],
)
@pytest.mark.parametrize("encoding", ["utf-8", "cp1252"])
def test_a_date_is_read_in_english_and_german(
    tmp_path: Path, date: str, moment: str, encoding: str
) -> None:
    block = f"Begin Triggerblock {date}"
    for header in ([f"date {date}", BASE], [BASE, block], [DATE, BASE, block]):
        frames = read(tmp_path, *header, FIRST, SECOND, encoding=encoding)
        assert frames[0] == (local(moment), "1231")


@pytest.mark.parametrize(
    "date",
    [
        "Mer Déc 3 08:00:00.000 2025",
        "2026-03-20T08:00:00Z",
        "20.03.2026 08:00:00",
        "03/04/2026 08:00:00",
        "Fri Mar 20 08:00:00",
        "Fri Mar 20 08:00:00 26",
        "Fri Mar 20 08:00:00 0026",
        "Fri Mar 32 08:00:00 2026",
        "Fri Mar 20 14:00:00 pm 2026",
        "Fri Mar 20 08:00:00 2026 (local)",
    ],
)
def test_a_date_in_another_form_is_refused(tmp_path: Path, date: str) -> None:
    for header in ([f"date {date}", BASE], [DATE, BASE, f"Begin Triggerblock {date}"]):
        with pytest.raises(ConfigurationError) as refused:
            read(tmp_path, *header, FIRST, SECOND)
        assert f"{date!r} is no date; {EXPECTED}" in str(refused.value)
        # A play that does not need it has the frames by the times between them.
        first, second = read(tmp_path, *header, FIRST, SECOND, needs_dates=False)
        assert (second[0] - first[0]).total_seconds() == 1.0


@pytest.mark.parametrize(
    ("behind", "complaint"),
    [
        ("base dec timestamps absolute", "'base dec timestamps absolute' behind the first frame"),
        ("base hex timestamps relative", "'base hex timestamps relative' behind the first frame"),
        ("base oct", "'base oct': expected base hex or dec"),
        ("date Sat Mar 21 08:00:00.000 2026", "'date Sat Mar 21 08:00:00.000 2026' behind the fir"),
    ],
)
def test_no_line_behind_the_first_frame_changes_what_frames_mean(
    tmp_path: Path, behind: str, complaint: str
) -> None:
    with pytest.raises(ConfigurationError) as refused:
        read(tmp_path, DATE, BASE, FIRST, behind, SECOND)
    assert complaint in str(refused.value)
    assert "further than 1 frames" in str(refused.value)


def test_a_date_only_behind_the_first_frame_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match="behind the first frame; expected it before"):
        read(tmp_path, BASE, FIRST, DATE, SECOND)


def test_the_header_may_stand_in_a_log_again(tmp_path: Path) -> None:
    plain = read(tmp_path, DATE, BASE, FIRST, SECOND)
    assert read(tmp_path, DATE, BASE, FIRST, DATE.upper(), "base hex", SECOND) == plain
    assert read(tmp_path, DATE, FIRST, "base hex // again", SECOND) == plain


def test_a_log_behind_another_one_has_its_own_times(tmp_path: Path) -> None:
    """Two files put together: the block of the second says when it was."""
    later = ["date Sat Mar 21 08:00:00 2026", BASE, "Begin Triggerblock Sat Mar 21 08:00:00 2026"]
    frames = read(tmp_path, DATE, BASE, f"Begin Triggerblock {DATE[5:]}", FIRST, *later, FIRST)
    assert [time for time, _ in frames] == [
        local("2026-03-20T08:00:01"),
        local("2026-03-21T08:00:01"),
    ]
    assert len(read(tmp_path, DATE, BASE, FIRST, "Date of measurement: today", SECOND)) == 2


def test_a_trigger_block_without_a_date_keeps_that_of_the_log(tmp_path: Path) -> None:
    plain = read(tmp_path, DATE, BASE, FIRST, SECOND)
    assert read(tmp_path, DATE, BASE, "Begin TriggerBlock", FIRST, SECOND) == plain
