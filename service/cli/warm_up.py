"""``bearing-twin warm-up``: compile the numerical kernels once, for the next starts."""

import os
from typing import Annotated

import typer


def warm_up(
    live: Annotated[
        bool, typer.Option("--live", help="Those of the live twin alone; a line for each.")
    ] = False,
) -> None:
    """Compile the numerical kernels into their cache; useful when an image is built."""
    from service.kernels import compile_kernels, compile_live_kernels

    if live:
        os.nice(10)  # a service that runs already goes first
        compile_live_kernels(lambda: typer.echo("a kernel"))
        return
    compile_kernels()
    typer.echo("The kernels are compiled.")
