"""The demo's account as a table for people."""

from datetime import datetime

from rich.console import Console
from rich.table import Table

from service.demo.score import Account, KeptAccount, SensorAccount


def print_account(document: Account, console: Console) -> None:
    """Print forecast and measurement of every high-risk stage, the warnings and the samples."""
    table = Table(title="Forecast before each high-risk stage and what was measured at its end, °C")
    for heading in ("stage", "ring", "forecast (95 % band)", "measured", "error", "in band"):
        table.add_column(heading, justify="left" if heading in ("stage", "ring") else "right")
    for stage in document["stages"]:
        for sensor, row in stage["sensors"].items():
            if row["forecast_c"] is None:
                cells = ["no forecast", _figure(row["measured_c"]), "", ""]
            else:
                cells = [
                    f"{row['forecast_c']:.1f} ({row['q025']:.1f} … {row['q975']:.1f})",
                    _figure(row["measured_c"]),
                    f"{row['error_c']:+.1f}",
                    f"{row['coverage_95']:.0%} of the time",
                ]
            table.add_row(stage["name"], sensor.split("_")[1], *cells)
    console.print(table)
    if "sisters" in document:
        console.print(_with_and_without(document))
    for stage in document["stages"]:
        if stage["forecast_made_at"]:
            console.print(
                f"{stage['name']}: began at {_local(stage['start'])}, forecast made at "
                f"{_local(stage['forecast_made_at'])} by model {stage['forecast_model_version']}."
            )
    for stage in document["stages"]:
        warning = stage["warning"]
        if warning["forecast_limit_at"]:
            reached = warning["measured_limit_at"]
            console.print(
                f"{stage['name']}: limit announced at {_local(warning['forecast_limit_at'])}, "
                + (f"reached at {_local(reached)}" if reached else "not reached")
            )
    for risk, kept in document["forecasts_kept"].items():
        console.print(_record(risk, kept))
    samples = document["samples"]
    console.print(f"Good samples stored: {samples['modbus']} by Modbus, {samples['can']} by CAN.")


def _with_and_without(document: Account) -> Table:
    """What the last bench forecast without its sisters, and what with them."""
    asset = f"bench-{len(document.get('sisters', {})) + 1}"
    table = Table(title=f"What {asset} gained by its sisters: error at the end of a stage, K")
    for heading in ("stage", "ring", "without sisters", "with sisters"):
        table.add_column(heading, justify="left" if heading in ("stage", "ring") else "right")
    for stage in document["stages"]:
        for sensor, row in stage["sensors"].items():
            alone = stage.get("without_sisters", {}).get(sensor)
            cells = ["–" if one is None else _error_and_band(one) for one in (alone, row)]
            table.add_row(stage["name"], sensor.split("_")[1], *cells)
    return table


def _error_and_band(row: SensorAccount) -> str:
    if row["error_c"] is None or row["q025"] is None or row["q975"] is None:
        return "no forecast"
    return f"{row['error_c']:+.1f} (band ±{0.5 * (row['q975'] - row['q025']):.1f})"


def _record(risk: str, kept: KeptAccount) -> str:
    """One line: how many readings of the kept forecasts came as they were forecast."""
    if not kept["readings"]:
        return f"Kept forecasts, {risk} risk: none scored, {kept['set_aside']} set aside."
    names = {"arx": "ARX"}
    errors = ", ".join(
        f"{names.get(kind, kind)} {_figure(error)}" for kind, error in kept["naive_mae_k"].items()
    )
    return (
        f"Kept forecasts, {risk} risk: {kept['inside_95']} of {kept['readings']} readings 5 min to "
        f"4 h ahead inside the 95 % band ({kept['set_aside']} set aside); mean error "
        f"{_figure(kept['mae_k'])} K ({errors} K)."
    )


def _local(time: str) -> str:
    """Time of day with its zone, as the page shows it."""
    return datetime.fromisoformat(time).astimezone().strftime("%H:%M:%S %Z")


def _figure(value: float | None) -> str:
    return "–" if value is None else f"{value:.1f}"
