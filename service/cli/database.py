"""``bearing-twin db``: the store's schema."""

import typer

from service.cli.serve import ConfigFile
from service.settings import load_settings

db = typer.Typer(help="The store's schema.", no_args_is_help=True)


@db.callback()
def _group() -> None: ...


@db.command()
def upgrade(config: ConfigFile = None) -> None:
    """Bring the store up to the schema of this version."""
    from service.store import Store

    settings = load_settings(config)
    with Store.open(settings.service.database_url, settings.data_dir, migrate=True):
        typer.echo("The store is up to date.")
