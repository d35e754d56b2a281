"""``bearing-twin export-fmu``: a model file as an FMU, for other simulation programs."""

import json
import time
from pathlib import Path
from typing import Annotated

import typer

from service.cli.consoles import make_console
from service.cli.errors import BadInputError
from service.offline.interruption import exit_on_signals


def export_fmu(
    model: Annotated[
        Path, typer.Argument(metavar="MODEL.json", help="What 'bearing-twin identify' wrote.")
    ],
    out: Annotated[Path, typer.Option(metavar="FILE.fmu", help="File to write the FMU to.")],
    fmi: Annotated[int, typer.Option(metavar="2|3", help="Version of the standard FMI.")] = 2,
    as_json: Annotated[
        bool, typer.Option("--json", help="One JSON document on standard output.")
    ] = False,
) -> None:
    """Export the most probable model as an FMU, for co-simulation and model exchange.

    It computes what 'simulate' does, in C, on Linux x86-64; its sources are inside. A C compiler
    (cc) is needed here, and nothing where it runs.
    """
    if fmi not in (2, 3):
        raise BadInputError(f"--fmi {fmi}: expected 2 or 3")
    with exit_on_signals():
        # Imported here: the compiled twin takes a second to load, which --help should not pay.
        from service.offline.fmu.export import export_model
        from service.offline.model_file import IdentifiedModel
        from service.offline.tables import check_writable

        identified = IdentifiedModel.load(model)
        check_writable(out)
        began = time.monotonic()
        exported = export_model(identified, fmi, out)
        seconds = time.monotonic() - began
    if as_json:
        document = {
            "out": str(out),
            "seconds": seconds,
            "model": identified.model.name,
            "bearing": identified.model.machine,
            "fmi": fmi,
            "token": exported.token,
            "inputs": exported.names("input"),
            "parameters": exported.names("parameter"),
            "outputs": exported.names("output"),
        }
        typer.echo(json.dumps(document, allow_nan=False))
        return
    console = make_console()
    for what, causality in (("Inputs", "input"), ("Outputs", "output")):
        console.print(f"{what}: {', '.join(exported.names(causality))}", soft_wrap=True)
    console.print(f"FMU (FMI {fmi}.0): {out}", soft_wrap=True)
