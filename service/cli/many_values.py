"""Options that take values until the next option: ``--sisters A.json B.json --out C.json``."""

from collections.abc import Iterable, Sequence
from typing import Any

from typer.core import TyperCommand


def with_many_values(*options: str) -> type[TyperCommand]:
    """Make a kind of command whose named options take all values up to the next option.

    Each must be declared as a list; giving it several times does the same.
    """

    class ManyValuesCommand(TyperCommand):
        def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
            return super().parse_args(ctx, spread(args, options))

    return ManyValuesCommand


def spread(arguments: Iterable[str], options: Sequence[str]) -> list[str]:
    """Repeat an option before each of its values."""
    found: list[str] = []
    current = ""
    first = False
    for argument in arguments:
        if argument.startswith("-"):
            current = argument if argument in options else ""
            first = bool(current)
        elif current and not first:
            found.append(current)
        else:
            first = False
        found.append(argument)
    return found
