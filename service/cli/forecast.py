"""``bearing-twin forecast``: temperatures over a profile, from a model file."""

import json
import math
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.table import Table

from service.cli.consoles import make_console
from service.cli.errors import BadInputError
from service.offline.interruption import exit_on_signals
from twin_core.scores import WHOLE_RUN_LEVEL

if TYPE_CHECKING:
    from service.offline.forecasting import ProfileForecast
    from twin_core.forecasting.runaway import RunawayDistance


def forecast(
    model: Annotated[
        Path, typer.Argument(metavar="MODEL.json", help="Model file from 'bearing-twin identify'.")
    ],
    profile: Annotated[
        Path,
        typer.Option(
            metavar="PROFILE.csv",
            help="time_s,speed_rpm,load_n,ambient_c; seconds from the end of the history.",
        ),
    ],
    out: Annotated[
        Path, typer.Option(metavar="FORECAST.csv", help="File to write the forecast to.")
    ],
    history: Annotated[
        Path | None,
        typer.Option(metavar="DATA.csv", help="Recorded data up to now; its last row is time 0."),
    ] = None,
    initial_temperature_c: Annotated[
        float | None,
        typer.Option(
            help="Instead of a history: a machine at standstill, everywhere at this temperature."
        ),
    ] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="One JSON document on standard output.")
    ] = False,
) -> None:
    """Forecast all sensors and nodes with intervals; one row per row of the profile.

    Sensor quantiles are for what the sensor will read, node quantiles for the true temperature.
    Columns NAME_whole_low and NAME_whole_high: all readings of a run lie between them with 90 %.
    """
    if (history is None) == (initial_temperature_c is None):
        raise BadInputError("expected either --history or --initial-temperature-c")
    if initial_temperature_c is not None and not -60.0 <= initial_temperature_c <= 400.0:
        raise BadInputError(
            f"--initial-temperature-c {initial_temperature_c:g}: expected -60 to 400"
        )
    with exit_on_signals():
        # Imported here: the compiled twin takes a second to load, which --help should not pay.
        from service.offline.forecasting import FollowError, cold, follow, forecast_profile
        from service.offline.model_file import IdentifiedModel
        from service.offline.tables import (
            check_writable,
            read_profile,
            read_recording,
            write_forecast,
        )
        from service.offline.unit_doubts import doubts_of_profile, doubts_of_recording

        identified = IdentifiedModel.load(model)
        network = identified.machine.network
        rows = read_profile(profile, network)
        check_writable(out)
        doubts = doubts_of_profile(profile.name, rows, identified.machine)
        began = time.monotonic()
        try:
            if history is not None:
                recording = read_recording(history, network)
                doubts = doubts_of_recording(recording, identified.machine) + doubts
                present = follow(identified, recording)
            else:
                present = cold(identified, initial_temperature_c or 0.0)
        except FollowError as error:
            sys.stderr.write(f"bearing-twin: {error}; {out} is not written\n")
            raise typer.Exit(1) from error
        result = forecast_profile(identified, present, rows)
        result = replace(result, labels=(*doubts, *result.labels))
        write_forecast(out, result.time_s, result.names, result.quantiles, result.whole_run)
        seconds = time.monotonic() - began
    document = {
        "out": str(out),
        "seconds": seconds,
        "model": identified.model.name,
        "bearing": identified.model.machine,
        "sensors": result.highest(),
        "whole_run_level": WHOLE_RUN_LEVEL,
        "labels": list(result.labels),
        "runaway_probability": result.runaway_probability,
        "runaway_margin": _finite(result.runaway_margin),
        "initial_state": result.initial_state,
        "not_known": result.not_known,
    }
    if as_json:
        typer.echo(json.dumps(document, allow_nan=False))
    else:
        _print(result, out)


def _finite(margin: "RunawayDistance | None") -> dict[str, float | None] | None:
    """The margin for JSON; null where there is none, or where a figure is not finite."""
    if margin is None:
        return None
    return {
        name: value if math.isfinite(value) else None
        for name in margin.__slots__
        for value in (getattr(margin, name),)
    }


def _margin_text(margin: "RunawayDistance") -> str:
    at = f"{margin.speed_rpm:.0f} rpm, {margin.load_n:.0f} N"
    parts = [f"Runaway at {at}: {100.0 * margin.probability:.1f} %"]
    if math.isfinite(margin.margin_k):
        parts.append(f"margin {margin.margin_k:.0f} K")
    if math.isfinite(margin.margin_n):
        parts.append(f"{margin.margin_n:+.0f} N to 5 %")
    return ", ".join(parts)


def _print(result: "ProfileForecast", out: Path) -> None:
    console = make_console()
    table = Table("highest of", "median, °C", "97.5 %, °C", "whole run 90 %, °C")
    for name, row in result.highest().items():
        table.add_row(name, *(f"{value:.1f}" for value in row.values()))
    console.print(table)
    for label in result.labels:
        console.print(f"Note: {label}")
    if (margin := result.runaway_margin) is not None:
        console.print(_margin_text(margin))
    console.print(f"Forecast: {out}", soft_wrap=True)
