"""The standard channels for the dashboard: writes ``static/js/channels.js`` from their table.

Run ``python -m service.web.pages.channels`` after a change of `service.domain.channels`.
"""

import json
from pathlib import Path

from service.domain.channels import STANDARD

FILE = Path(__file__).parent / "static" / "js" / "channels.js"


def module() -> str:
    """Text of the module."""
    rows = ",\n".join(
        "  " + json.dumps([one.name, one.label, one.unit, one.part], ensure_ascii=False)
        for one in STANDARD
    )
    return f"""\
// Written by service/web/pages/channels.py from service/domain/channels.py. Do not edit.
const STANDARD = [
{rows},
];

const names = (wanted) => STANDARD.filter(([, , , part]) => part === wanted).map(([name]) => name);

/** Speed, load and ambient: the operating point. */
export const OPERATION = names('operation');
/** The temperatures of the rings. */
export const RINGS = names('ring');
export const LABELS = Object.fromEntries(STANDARD.map(([name, label]) => [name, label]));
export const UNITS = Object.fromEntries(STANDARD.map(([name, , unit]) => [name, unit]));
"""


if __name__ == "__main__":
    FILE.write_text(module(), encoding="utf-8")
