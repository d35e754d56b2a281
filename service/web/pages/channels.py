"""The standard channels for the dashboard: writes ``static/js/parts/channels.js``.

Run ``python -m service.web.pages.channels`` after a change of `service.domain.channels`.
"""

import json
from pathlib import Path

from service.domain.channels import OBSERVED_CHANNELS, OPERATING_CHANNELS, RING_SENSORS, STANDARD

FILE = Path(__file__).parent / "static" / "js" / "parts" / "channels.js"


def module() -> str:
    """Text of the module."""
    rows = ",\n".join(
        "  " + json.dumps([one.name, one.label, one.unit], ensure_ascii=False) for one in STANDARD
    )
    return f"""\
// Written by service/web/pages/channels.py from service/domain/channels.py. Do not edit.
const STANDARD = [
{rows},
];

/** Speed, load and ambient: the operating point. */
export const OPERATION = {list(OPERATING_CHANNELS)};
/** What else is measured of the machine: shown and watched only. */
export const OBSERVED = {list(OBSERVED_CHANNELS)};
/** The temperatures of the rings that models compute. */
export const RINGS = {list(RING_SENSORS)};
export const LABELS = Object.fromEntries(STANDARD.map(([name, label]) => [name, label]));
export const UNITS = Object.fromEntries(STANDARD.map(([name, , unit]) => [name, unit]));
"""


if __name__ == "__main__":
    FILE.write_text(module(), encoding="utf-8")
