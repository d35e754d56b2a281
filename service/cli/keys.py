"""``bearing-twin keys``: API keys, whether the service runs or not."""

import getpass
import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Annotated

import typer

from service.cli.serve import ConfigFile, begin_file
from service.clock import rfc3339
from service.domain.roles import ROLES
from service.site.settings import load_settings

# What only some commands need is imported where it is needed: the help must not wait for it.
if TYPE_CHECKING:
    from service.security.keys import Actor
    from service.store import ApiKey, Store

keys = typer.Typer(help="API keys: create, list, revoke.", no_args_is_help=True)

AsJson = Annotated[bool, typer.Option("--json", help="One JSON document on standard output.")]


@contextmanager
def _store(config: ConfigFile) -> Iterator["Store"]:
    from service.store import Store

    settings = load_settings(config)
    with Store.open(settings.service.database_url, settings.data_dir) as store:
        yield store


@keys.command()
def create(
    role: Annotated[str, typer.Option(help=f"{', '.join(ROLES[:-1])} or {ROLES[-1]}.")],
    expires_in_days: Annotated[
        float | None, typer.Option(help="Days after which the key expires; default never.")
    ] = None,
    label: Annotated[str, typer.Option(help="Label of the key.")] = "",
    config: ConfigFile = None,
    as_json: AsJson = False,
) -> None:
    """Create a key and print it; it is shown only once and stored as a hash."""
    from service.security.keys import create_key

    begin_file(config)
    with _store(config) as store:
        new = create_key(store, role, expires_in_days, label, actor=command_line_actor())
    typer.echo(json.dumps({"key": new.text} | _facts(new.record)) if as_json else new.text)


@keys.command("list")
def list_(config: ConfigFile = None, as_json: AsJson = False) -> None:
    """List all keys by their prefixes, with role, label, creation and expiry (UTC)."""
    from rich.table import Table

    from service.cli.consoles import make_console
    from service.security.keys import list_keys

    with _store(config) as store:
        records = list_keys(store)
    if as_json:
        typer.echo(json.dumps({"keys": [_facts(record) for record in records]}))
        return
    # The prefix names a key as well as its id does, and fits next to the rest.
    columns = ("prefix", "role", "label", "created", "expires", "revoked")
    table = Table(box=None, pad_edge=False)
    for name in columns:
        table.add_column(name, no_wrap=name != "label", overflow="fold")
    for record in records:
        facts = _facts(record)
        days = {name: (facts[name] or "")[:10] for name in columns[3:]}
        table.add_row(*(str((facts | days)[name] or "") for name in columns))
    make_console().print(table)


@keys.command()
def revoke(
    key: Annotated[
        str | None, typer.Argument(metavar="[ID]", help="Id or prefix of the key.")
    ] = None,
    every: Annotated[
        bool, typer.Option("--all", help="All keys, as after restoring a backup.")
    ] = False,
    config: ConfigFile = None,
    as_json: AsJson = False,
) -> None:
    """Revoke a key, or all; a running service refuses them within two seconds."""
    from service.security.keys import UnknownKeyError, revoke_all_keys, revoke_key

    if (key is None) is not every:
        raise UnknownKeyError("keys revoke: expected the id or prefix of a key, or --all")
    with _store(config) as store:
        if key is None:
            records = revoke_all_keys(store, actor=command_line_actor())
            facts = {"keys": [_facts(record) for record in records]}
            many = "1 key is" if len(records) == 1 else f"{len(records)} keys are"
            typer.echo(json.dumps(facts) if as_json else f"{many} revoked")
            return
        record = revoke_key(store, key, actor=command_line_actor())
    typer.echo(json.dumps(_facts(record)) if as_json else f"{record.prefix} is revoked")


def command_line_actor() -> "Actor":
    """Who sits at the command line, for the audit trail."""
    from service.security.keys import Actor

    try:
        user = getpass.getuser()
    except (OSError, KeyError):  # a user id without a name, as in a container
        user = str(os.getuid())
    return Actor(f"command line, {user}")


def _facts(record: "ApiKey") -> dict[str, str | None]:
    return {
        "id": record.id,
        "prefix": record.prefix,
        "role": record.role,
        "label": record.label,
        "created": rfc3339(record.created_us),
        "expires": rfc3339(record.expires_us) if record.expires_us is not None else None,
        "revoked": rfc3339(record.revoked_us) if record.revoked_us is not None else None,
    }
