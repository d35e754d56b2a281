"""A process that does one identification and nothing else, to be timed from outside."""

import sys
from pathlib import Path
from typing import Any

import numpy as np

from twin_core.bearings import bearing
from twin_core.identification import (
    IdentificationData,
    IdentificationResult,
    IdentificationWindow,
    identify,
)
from twin_core.models import build_model
from twin_core.windows import MinuteData


def identified(name: str, designation: str, rows: MinuteData) -> IdentificationResult:
    """Identify a model with the default method from rows that begin at standstill."""
    model = build_model(name, bearing=bearing(designation))
    return identify(model, IdentificationData((IdentificationWindow(rows, at_rest=True),)))


def keep(file: Path, rows: MinuteData) -> None:
    """Write rows for another process."""
    columns: dict[str, Any] = {
        "time_s": rows.time_s,
        "speed_rpm": rows.speed_rpm,
        "load_n": rows.load_n,
        "ambient_c": rows.ambient_c,
        "good": rows.good,
    }
    columns |= {f"sensor {name}": values for name, values in rows.temperatures_c.items()}
    np.savez(file, **columns)


def read(file: Path) -> MinuteData:
    """Take back what `keep` wrote."""
    with np.load(file) as columns:
        return MinuteData(
            columns["time_s"],
            columns["speed_rpm"],
            columns["load_n"],
            columns["ambient_c"],
            {
                name.removeprefix("sensor "): columns[name]
                for name in columns.files
                if name.startswith("sensor ")
            },
            columns["good"],
        )


if __name__ == "__main__":
    identified(sys.argv[1], sys.argv[2], read(Path(sys.argv[3])))
