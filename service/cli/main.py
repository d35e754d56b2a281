"""Commands and how they end: 0 done, 1 failure, 2 something the user can mend, 75 try again."""

import os
import sys
from importlib.metadata import version
from typing import Annotated, NoReturn

import typer
from typer.exceptions import TyperException

from service.cli.backup import backup, restore
from service.cli.bench import virtual_bench
from service.cli.benchmark import benchmark
from service.cli.check import check
from service.cli.database import db
from service.cli.demo import demo
from service.cli.drift import drift
from service.cli.forecast import forecast
from service.cli.grease import grease_renewed
from service.cli.identify import identify
from service.cli.keys import keys
from service.cli.serve import serve
from service.cli.study import study
from service.cli.transfer import export, import_
from service.cli.warm_up import warm_up
from service.domain.errors import ServiceError, TemporaryError

_OURS = ("service", "adapters", "twin_core")

app = typer.Typer(
    name="bearing-twin",
    help="A networked digital twin for grease-lubricated rolling bearings.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
app.command()(demo)
app.command()(serve)
app.command()(check)
app.command("virtual-bench")(virtual_bench)
app.command()(identify)
app.command()(forecast)
app.command()(drift)
app.command()(study)
app.command()(benchmark)
app.command("grease-renewed")(grease_renewed)
app.command("import")(import_)
app.command()(export)
app.command()(backup)
app.command()(restore)
app.command("warm-up", hidden=True)(warm_up)
app.add_typer(keys, name="keys")
app.add_typer(db, name="db")


def _show_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"bearing-twin {version('bearing-twin')}")
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

    Our own kinds of ValueError, a store that cannot be used and options that do not fit are what a
    user can mend: they end with one line per error on standard error and exit status 2. Trouble
    that passes by itself ends with one line and status 75 (EX_TEMPFAIL of sysexits.h): whoever
    started the command may start it again. Any other exception is a fault of ours and keeps its
    traceback.
    """
    try:
        status = app(standalone_mode=False)
    except TyperException as error:
        message = str(getattr(error, "format_message", error.__str__)())
        if message:
            _refuse(message)
        sys.exit(2)  # called without arguments: the help has been shown
    except ServiceError as error:
        passes = isinstance(error, TemporaryError) and error.passes
        _refuse(str(error), status=os.EX_TEMPFAIL if passes else 2)
    except ValueError as error:
        if type(error).__module__.partition(".")[0] not in _OURS:
            raise
        _refuse(*getattr(error, "lines", (str(error),)))
    sys.exit(status if isinstance(status, int) else 0)


def _refuse(*messages: str, status: int = 2) -> NoReturn:
    for message in messages:
        sys.stderr.write(f"bearing-twin: {' '.join(message.split())}\n")
    sys.exit(status)
