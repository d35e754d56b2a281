"""``bearing-twin example``: the example configuration, to write one's own from."""

import os
from importlib.resources import as_file, files
from pathlib import Path
from typing import Annotated

import typer

from service.cli.errors import BadInputError

_NAME = "bearing-twin.example.toml"
#: Where it is in a checkout; a wheel has it beside this module.
_CHECKOUT = Path(__file__).parents[2] / "deploy"


def example(
    folder: Annotated[
        Path, typer.Argument(metavar="FOLDER", help="Existing folder to write into.")
    ] = Path(),
) -> None:
    """Write the example configuration and its DBC file, with every section explained."""
    if not folder.is_dir():
        raise BadInputError(f"FOLDER = {str(folder)!r}: expected an existing folder")
    here = files("service.cli") / _NAME
    with as_file(here if here.is_file() else _CHECKOUT / _NAME) as text:
        contents = {_NAME: text.read_bytes()}
    contents["bench.dbc"] = (files("adapters.virtual_bench") / "bench.dbc").read_bytes()
    for name in contents:
        if os.path.lexists(folder / name):  # a link that leads to no file would be followed
            raise BadInputError(f"{str(folder / name)!r} is there already; expected no such file")
    for name, content in contents.items():
        (folder / name).write_bytes(content)
        typer.echo(folder / name)
