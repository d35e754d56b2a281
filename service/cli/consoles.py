"""What the commands print on: texts of users stand there as they are."""

from rich.console import Console


def make_console(*, stderr: bool = False) -> Console:
    """Make a console that takes no text for markup, also in a table: ``[/red]`` is a label."""
    return Console(stderr=stderr, markup=False, highlight=False, emoji=False)
