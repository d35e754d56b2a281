"""The list of the page's views is made of the views that are there."""

import re
from pathlib import Path

import pytest
from pydantic import ValidationError

from service.web.pages import static_directory
from service.web.pages.views import FILE, module, views


def test_the_list_has_the_views_that_are_there() -> None:
    assert module() == FILE.read_text("utf-8"), "run python -m service.web.pages.views"
    for name, view in views().items():
        text = (FILE.parent.parent / name / "view.js").read_text("utf-8")
        assert re.search(r"^export class (Operator)?View extends Panel", text, re.MULTILINE), name
        style = static_directory() / "css" / f"{name}.css"
        assert style.is_file() or not view.style, style


def add(folder: Path, name: str, described: str) -> None:
    (folder / name).mkdir()
    (folder / name / "view.js").write_text(f"// A view.\n{described}\nexport class View {{}}\n")


def test_a_view_is_added_by_its_folder(tmp_path: Path) -> None:
    add(tmp_path, "later", '// view: {"place": 20, "title": "Later", "from": "admin", "of": "all"}')
    add(tmp_path, "first", '// view: {"place": 10, "title": "First", "from": "viewer"}')
    (tmp_path / "parts").mkdir()
    rows = [line for line in module(tmp_path).splitlines() if line.startswith("  ")]
    assert rows == [
        "  first: { title: 'First', from: 'viewer' },",
        "  later: { title: 'Later', from: 'admin', of: 'all' },",
    ]


@pytest.mark.parametrize(
    ("described", "said"),
    [
        ("// Nothing.", "no second line such as // view"),
        ('// view: {"place": 1, "title": "A", "from": "guest"}', "from"),
        ('// view: {"place": 1, "title": "A", "from": "viewer", "tab": 1}', "tab"),
    ],
)
def test_a_view_without_a_description_is_named(tmp_path: Path, described: str, said: str) -> None:
    add(tmp_path, "one", described)
    with pytest.raises((ValueError, ValidationError), match=said):
        module(tmp_path)
