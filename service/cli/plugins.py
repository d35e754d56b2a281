"""Commands that other packages bring, by entry points; looked up only when one is called."""

from importlib.metadata import EntryPoint, entry_points
from typing import Any, Final

import typer
from typer.core import TyperGroup

from service.cli.errors import BadInputError

GROUP: Final = "bearing_twin.commands"
"""Name of a command = "module:function", as `typer.Typer.command` takes it."""

_LABORATORY: Final = ("study", "benchmark", "demo-fleet")


class WithPlugins(TyperGroup):
    """Own commands first, then those of other packages."""

    def list_commands(self, ctx: Any) -> list[str]:
        """Names of all, for the help."""
        own = super().list_commands(ctx)
        return own + sorted(set(_plugins().names).difference(own))

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """The command of that name.

        Raises `BadInputError` if it is one of the laboratory, which is not installed.
        """
        own = super().get_command(ctx, cmd_name)
        if own is not None:
            return own
        for plugin in _plugins().select(name=cmd_name):
            return _command(plugin, self.context_settings)
        if cmd_name in _LABORATORY:
            raise BadInputError(
                f"{cmd_name}: a command of the laboratory, which is not installed; expected, in a "
                "checkout of Bearing Twin: pip install --editable laboratory"
            )
        return None


def _plugins() -> Any:
    return entry_points(group=GROUP)


def _command(plugin: EntryPoint, settings: Any) -> Any:
    alone = typer.Typer(add_completion=False, context_settings=settings)
    alone.command(plugin.name)(plugin.load())
    return typer.main.get_command(alone)
