"""CONTRIBUTING.md says what is true of the code."""

import re

from package_graph import PAGE, ROOT, imports, needed, with_picture


def test_the_picture_of_the_packages_is_up_to_date() -> None:
    text = PAGE.read_text(encoding="utf-8")
    assert text == with_picture(text), "run python tests/package_graph.py"


def test_the_picture_leaves_out_only_what_follows() -> None:
    edges = {("a", "b"), ("b", "c"), ("a", "c"), ("a", "d")}
    assert needed(edges) == {("a", "b"), ("b", "c"), ("a", "d")}
    assert ("live", "twin_core") in imports()


def test_every_file_that_the_ten_changes_name_is_there() -> None:
    text = PAGE.read_text(encoding="utf-8")
    section = text[text.index("## Ten changes") :].partition("\n## ")[0]
    named = re.findall(r"`([\w/.<>-]+/[\w.<>-]*)`", section)
    assert len(named) > 10
    missing = [name for name in named if "<" not in name and not (ROOT / name).exists()]
    assert missing == []
