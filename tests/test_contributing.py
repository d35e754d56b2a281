"""CONTRIBUTING.md says what is true of the code."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "CONTRIBUTING.md"


def test_every_file_that_the_ten_changes_name_is_there() -> None:
    text = PAGE.read_text(encoding="utf-8")
    section = text[text.index("## Ten changes") :].partition("\n## ")[0]
    named = re.findall(r"`([\w/.<>-]+/[\w.<>-]*)`", section)
    assert len(named) > 10
    missing = [name for name in named if "<" not in name and not (ROOT / name).exists()]
    assert missing == []
