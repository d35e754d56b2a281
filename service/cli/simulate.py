"""``bearing-twin simulate``: temperatures of a model file over a profile, without intervals."""

import json
import sys
import time
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from service.cli.consoles import make_console
from service.cli.errors import BadInputError
from service.offline.interruption import exit_on_signals


def simulate(
    model: Annotated[
        Path, typer.Argument(metavar="MODEL.json", help="Model file from 'bearing-twin identify'.")
    ],
    profile: Annotated[
        Path,
        typer.Option(
            metavar="PROFILE.csv",
            help="time_s,speed_rpm,load_n,ambient_c; each row holds until the next one.",
        ),
    ],
    initial_temperature_c: Annotated[
        float, typer.Option(help="Temperature of the whole machine at the first row.")
    ],
    out: Annotated[
        Path, typer.Option(metavar="OUT.csv", help="File to write the temperatures to.")
    ],
    as_json: Annotated[
        bool, typer.Option("--json", help="One JSON document on standard output.")
    ] = False,
) -> None:
    """Simulate the most probable model; true temperatures at each row of the profile.

    Neither intervals nor errors of sensors: for these there is 'forecast'. The grease is as run
    in as at the start of the identification data.
    """
    if not -60.0 <= initial_temperature_c <= 400.0:
        raise BadInputError(
            f"--initial-temperature-c {initial_temperature_c:g}: expected -60 to 400"
        )
    with exit_on_signals():
        # Imported here: the compiled twin takes a second to load, which --help should not pay.
        from service.offline.model_file import IdentifiedModel
        from service.offline.simulation import RunAwayError, simulate_profile
        from service.offline.tables import check_writable, read_profile, write_simulation
        from service.offline.unit_doubts import doubts_of_profile

        identified = IdentifiedModel.load(model)
        rows = read_profile(profile, identified.machine.network)
        check_writable(out)
        for line in doubts_of_profile(profile.name, rows, identified.machine):
            sys.stderr.write(f"bearing-twin: warning: {line}\n")
        began = time.monotonic()
        try:
            found = simulate_profile(identified, rows, initial_temperature_c)
        except RunAwayError as error:
            sys.stderr.write(f"bearing-twin: {error}; {out} is not written\n")
            raise typer.Exit(1) from error
        write_simulation(out, found.time_s, found.names, found.temperatures_c)
        seconds = time.monotonic() - began
    highest_c = {
        name: float(found.temperatures_c[:, column].max())
        for column, name in enumerate(found.sensors)
    }
    if as_json:
        document = {
            "out": str(out),
            "seconds": seconds,
            "model": identified.model.name,
            "bearing": identified.model.machine,
            "rows": int(found.time_s.size),
            "sensors": {name: {"max_c": value} for name, value in highest_c.items()},
        }
        typer.echo(json.dumps(document, allow_nan=False))
        return
    console = make_console()
    table = Table("highest of", "°C")
    for name, value in highest_c.items():
        table.add_row(name, f"{value:.1f}")
    console.print(table)
    console.print(f"Simulation: {out}", soft_wrap=True)
