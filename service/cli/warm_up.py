"""``bearing-twin warm-up``: compile the numerical kernels once, for the next starts."""

import typer


def warm_up() -> None:
    """Compile the numerical kernels into their cache; useful when an image is built."""
    from service.kernels import compile_kernels

    compile_kernels()
    typer.echo("The kernels are compiled.")
