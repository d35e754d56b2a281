"""The views of the dashboard: writes ``static/js/app/views.js``, the list of those that are there.

A view is a folder below ``static/js`` with the class ``View`` in its ``view.js``, and its style is
``static/css/<folder>.css``. The second line of ``view.js`` describes it::

    // view: {"place": 70, "title": "Accuracy", "from": "viewer"}

``place`` orders the tabs, ``from`` is the role that it needs. A view with ``"of": "all"`` shows
no asset of its own; ``"of": "none"`` can be shown without any asset. A hidden view has no tab; one
without style has it in the first sheet. Run ``python -m service.web.pages.views`` after a change.
"""

import json
import re
from pathlib import Path
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field

from service.web.pages.packing import PackingError

FOLDER = Path(__file__).parent / "static" / "js"
FILE = FOLDER / "app" / "views.js"
_DESCRIBED = re.compile(r"\A//.*\n// view: (\{.*\})\n")


class View(BaseModel):
    """What the second line of a ``view.js`` says."""

    model_config = ConfigDict(extra="forbid")

    place: int = Field(exclude=True)
    title: str
    role: Literal["viewer", "operator", "engineer", "admin"] = Field(alias="from")
    of: Literal["one", "all", "none"] = "one"
    hidden: bool = False
    style: bool = True


def views(folder: Path = FOLDER) -> dict[str, View]:
    """The views by their folder, in the order of the tabs."""
    found = {}
    for file in folder.glob("*/view.js"):
        described = _DESCRIBED.match(file.read_text(encoding="utf-8"))
        if described is None:
            raise PackingError(f"{file}: no second line such as // view: {{...}}")
        found[file.parent.name] = View.model_validate_json(described[1])
    return dict(sorted(found.items(), key=lambda item: item[1].place))


def module(folder: Path = FOLDER) -> str:
    """Text of the list."""
    rows = [f"  {name}: {_object(view)},\n" for name, view in views(folder).items()]
    return f"""\
// Written by service/web/pages/views.py from the second lines of ../*/view.js. Do not edit.
/** @type {{{{ [name: string]: Page.View }}}} */
export const VIEWS = {{
{"".join(rows)}}};
"""


def _object(view: View) -> str:
    fields = view.model_dump(by_alias=True, exclude_defaults=True)
    pairs = (f"{key}: {json.dumps(value)}".replace('"', "'") for key, value in fields.items())
    return f"{{ {', '.join(pairs)} }}"


if __name__ == "__main__":
    FILE.write_text(module(), encoding="utf-8")
