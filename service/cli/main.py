"""Commands and how they end: 0 done, 1 failure, 2 something the user can mend, 75 try again."""

import io
import sys
from typing import Annotated

import typer
from typer.exceptions import TyperException

from service import __version__
from service.app.exits import refusals, refuse
from service.cli.backup import backup, restore
from service.cli.bench import virtual_bench
from service.cli.check import check
from service.cli.database import db
from service.cli.demo import demo
from service.cli.example import example
from service.cli.export_fmu import export_fmu
from service.cli.fleet_bench import virtual_fleet
from service.cli.forecast import forecast
from service.cli.grease import grease_renewed
from service.cli.identify import identify
from service.cli.keys import keys
from service.cli.many_values import with_many_values
from service.cli.modbus_map import modbus_map
from service.cli.plugins import WithPlugins
from service.cli.serve import serve
from service.cli.simulate import simulate
from service.cli.transfer import export, import_
from service.cli.warm_up import warm_up
from service.feature_folders import modules

app = typer.Typer(
    name="bearing-twin",
    cls=WithPlugins,
    help="A networked digital twin for grease-lubricated rolling bearings.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
app.command()(demo)
app.command()(serve)
app.command()(check)
app.command()(example)
app.command("virtual-bench")(virtual_bench)
app.command("virtual-fleet")(virtual_fleet)
app.command(cls=with_many_values("--sisters"))(identify)
app.command()(forecast)
app.command()(simulate)
app.command("export-fmu")(export_fmu)
app.command("modbus-map")(modbus_map)
app.command("grease-renewed")(grease_renewed)
app.command("import")(import_)
app.command()(export)
app.command()(backup)
app.command()(restore)
app.command("warm-up", hidden=True)(warm_up)
for _, feature in modules("commands"):
    feature.register(app)
app.add_typer(keys, name="keys")
app.add_typer(db, name="db")


def _show_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"bearing-twin {__version__}")
        raise typer.Exit


@app.callback()
def _options(
    show_version: Annotated[
        bool,
        typer.Option(
            "--version", callback=_show_version, is_eager=True, help="Show the version and exit."
        ),
    ] = False,
) -> None: ...


def main() -> None:
    """Run the command line.

    What a user can correct ends as `service.app.exits` says; options that do not fit end with
    status 2.
    """
    if isinstance(sys.stdout, io.TextIOWrapper):  # a terminal may know fewer characters
        sys.stdout.reconfigure(errors="replace")
    with refusals():
        try:
            status = app(standalone_mode=False)
        except TyperException as error:
            message = str(getattr(error, "format_message", error.__str__)())
            if message:
                refuse(message)
            sys.exit(2)  # called without arguments: the help has been shown
    sys.exit(status if isinstance(status, int) else 0)
