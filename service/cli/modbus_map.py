"""``bearing-twin modbus-map``: which register of the Modbus server holds what."""

import csv
import sys
from typing import Annotated

import typer

from service.cli.serve import ConfigFile
from service.site.settings import load_settings


def modbus_map(
    config: ConfigFile = None,
    as_csv: Annotated[bool, typer.Option("--csv", help="CSV on standard output.")] = False,
) -> None:
    """Print the registers of the Modbus server of a configuration, to program the PLC with.

    Addresses count from 0. Registers are input and holding registers, bits are discrete inputs
    and coils. The map version is register 1 of the running server.
    """
    # Imported here: --help should not wait for it.
    from service.plant.modbus_server.register_map import Entry, map_of, without_room
    from service.spreadsheets import cell

    settings = load_settings(config)
    map = map_of(settings)
    for line in without_room(settings):
        sys.stderr.write(f"bearing-twin: warning: {line}\n")
    entries = map.entries()
    if as_csv:
        out = csv.writer(sys.stdout, lineterminator="\n")
        out.writerow(Entry._fields)
        out.writerows([cell(value) for value in entry] for entry in entries)
        return
    typer.echo(f"{'table':<9}{'address':>7} {'size':>4}  {'type':<7}  name")
    for one in entries:
        unit = f" [{one.unit}]" if one.unit else ""
        line = f"{one.table:<9}{one.address:>7} {one.size:>4}  {one.type:<7}  {one.name}{unit}"
        typer.echo(line)
    typer.echo(f"map version {map.version}, {len(map.tags)} tags, {map.end} registers")
