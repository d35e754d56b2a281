"""Commands that do their work."""

import json
import re
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import httpx2
import pytest
from patience import patience
from processes import Command, wait_until

from adapters.samples import Sample
from service import __version__
from service.clock import rfc3339
from service.security.keys import create_key
from service.store import AlarmChange, AlarmTransition, Retention, Store
from service.store.changes import document_of
from service.store.refused_changes import Refused

pytestmark = pytest.mark.wires

Cli = Callable[..., "subprocess.CompletedProcess[str]"]
COMMANDS = (
    "demo", "serve", "check", "virtual-bench", "identify", "forecast", "assets", "keys", "db",
)  # fmt: skip


def test_the_version_is_that_of_the_package(cli: Cli) -> None:
    ended = cli("--version")
    assert (ended.returncode, ended.stderr) == (0, "")
    assert ended.stdout == f"bearing-twin {__version__}\n"


def test_the_help_lists_the_commands(cli: Cli) -> None:
    ended = cli("-h")
    assert ended.returncode == 0
    for command in COMMANDS:
        assert re.search(rf"\b{command}\b", ended.stdout)
    assert "warm-up" not in ended.stdout, "nothing for users"


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_has_help(cli: Cli, command: str) -> None:
    ended = cli(command, "--help")
    assert ended.returncode == 0
    assert "Usage:" in ended.stdout


@pytest.mark.parametrize("arguments", [("--version",), ("--help",), ("serve", "--help")])
def test_nobody_waits_for_what_only_other_commands_need(
    tmp_path: Path, arguments: tuple[str, ...]
) -> None:
    """The compiled twin, the field buses and the database take seconds to load."""
    ended = subprocess.run(
        [sys.executable, "-X", "importtime", "-m", "service", *arguments],
        cwd=tmp_path, capture_output=True, text=True, timeout=patience(180), check=False,
    )  # fmt: skip
    assert ended.returncode == 0
    loaded = {line.rpartition("|")[2].strip() for line in ended.stderr.splitlines()}
    assert "typer" in loaded
    # numpy comes with the settings, which know networks; it takes a tenth of a second.
    assert not loaded & {"numba", "scipy", "sqlalchemy", "pymodbus", "can", "fastapi"}


def test_a_label_is_a_label_whatever_it_looks_like(cli: Cli) -> None:
    for label in ("[/red]pump", "[bold]hall[/bold]", ":smile: press", "=1+1"):
        assert cli("keys", "create", "--role", "viewer", "--label", label).returncode == 0
        listed = cli("keys", "list")
        assert listed.returncode == 0, listed.stderr[-2000:]
        assert label in listed.stdout


def test_all_keys_are_revoked_at_once(cli: Cli) -> None:
    for role in ("viewer", "admin", "gateway"):
        cli("keys", "create", "--role", role)
    assert cli("keys", "revoke", "--all").stdout == "3 keys are revoked\n"
    listed = json.loads(cli("keys", "list", "--json").stdout)["keys"]
    assert all(key["revoked"] for key in listed)
    again = cli("keys", "revoke", "--all", "--json")
    assert json.loads(again.stdout) == {"keys": []}
    for arguments in ((), ("--all", listed[0]["id"])):
        refused = cli("keys", "revoke", *arguments)
        assert refused.returncode == 2
        assert "expected the id or prefix of a key, or --all" in refused.stderr


def test_keys_live_from_creation_to_revocation(cli: Cli) -> None:
    created = cli("keys", "create", "--role", "operator", "--expires-in-days", "2", "--json")
    assert created.returncode == 0, created.stderr
    key = json.loads(created.stdout)
    assert set(key) >= {"key", "id", "prefix", "role", "expires"}
    assert key["role"] == "operator"
    assert key["key"].startswith(key["prefix"])
    plain = cli("keys", "create", "--role", "viewer")
    assert re.fullmatch(r"bt_\S+\n", plain.stdout), "only the key"
    assert plain.stderr == ""

    listed = json.loads(cli("keys", "list", "--json").stdout)["keys"]
    assert [one["role"] for one in listed] == ["operator", "viewer"]
    assert [one["expires"] is None for one in listed] == [False, True]
    assert "key" not in listed[0]
    assert key["prefix"] in cli("keys", "list").stdout

    revoked = cli("keys", "revoke", key["id"], "--json")
    assert revoked.returncode == 0
    assert json.loads(revoked.stdout)["revoked"] is not None
    by_prefix = cli("keys", "revoke", listed[1]["prefix"])
    assert by_prefix.stdout == f"{listed[1]['prefix']} is revoked\n"
    listed = json.loads(cli("keys", "list", "--json").stdout)["keys"]
    assert all(one["revoked"] for one in listed)


def test_without_a_configuration_the_data_are_in_var(cli: Cli, tmp_path: Path) -> None:
    ended = cli("db", "upgrade")
    assert (ended.returncode, ended.stderr) == (0, "")
    assert ended.stdout == "The store is up to date.\n"
    assert (tmp_path / "var" / "bearing-twin.db").exists()
    assert cli("db", "upgrade").returncode == 0, "again is no error"


def test_a_key_made_while_the_service_runs_opens_it_until_it_is_revoked(
    cli: Cli, configure: Callable[..., Path], start: Callable[..., object], port: int
) -> None:
    config = str(configure())
    start("serve", "-c", config)
    key = cli("keys", "create", "--role", "viewer", "-c", config).stdout.strip()
    url = f"http://127.0.0.1:{port}/api/v1/assets"
    assert httpx2.get(url, headers={"X-API-Key": key}).status_code == 200
    assert cli("keys", "revoke", key[:11], "-c", config).returncode == 0
    wait_until(
        lambda: httpx2.get(url, headers={"X-API-Key": key}).status_code == 401, 60, "it is refused"
    )


def test_the_time_from_which_raw_samples_are_kept_is_shown_and_lowered(
    cli: Cli, tmp_path: Path
) -> None:
    config = tmp_path / "bearing-twin.toml"
    config.write_text('[service]\ndata_dir = "var"\n')
    day_us = 86_400_000_000
    now_us = time.time_ns() // 1000
    with Store.open("", tmp_path / "var") as store:
        store.samples.write(
            [Sample("a", "x", at_us, 1.0, 192, 0) for at_us in (now_us - 50 * day_us, now_us)]
        )
        store.rollups.expire(Retention(raw_days=10.0), now_us)
        kept_from = rfc3339(store.samples.kept_from_us)
    shown = cli("db", "horizon", "-c", str(config))
    assert (shown.returncode, shown.stdout) == (0, f"Raw samples are kept from {kept_from} on.\n")
    refused = cli("db", "horizon", "--lower", "yesterday", "-c", str(config))
    assert refused.returncode == 2
    assert "--lower: time 'yesterday': expected RFC 3339" in refused.stderr
    lowered = cli("db", "horizon", "--lower", "2001-01-01T00:00:00Z", "-c", str(config), "--json")
    assert json.loads(lowered.stdout) == {"raw_kept_from": "2001-01-01T00:00:00.000Z"}


def test_refused_changes_are_listed_and_repeated(
    cli: Cli, refused: Callable[..., str], configure: Callable[..., Path], tmp_path: Path
) -> None:
    config = str(configure())
    assert cli("db", "refused", "-c", config).stdout == (
        "No change waits that the store did not take.\n"
    )
    line = AlarmTransition(
        None, "motor-1", "model drift", "", "", 7, "", "", "eva", "", None, "It drifts"
    )
    change = AlarmChange(None, (line,))
    with Store.open("", tmp_path / "data") as store:
        store.refused.add(Refused(change, document_of(change), "of a test", None))
    shown = cli("db", "refused", "-c", config).stdout
    assert "alarm: model drift of motor-1: of a test" in shown
    assert "change 9: not known" in refused("db", "refused", "--repeat", "9", "-c", config)
    done = json.loads(cli("db", "refused", "--repeat", "1", "-c", config, "--json").stdout)
    assert done == {"repeated": "1 lines of the journal", "items": []}
    with Store.open("", tmp_path / "data") as store:
        assert store.alarms.journal().items[0] == line


def test_grease_is_renewed_in_the_store_while_no_service_runs(
    cli: Cli,
    refused: Callable[..., str],
    configure: Callable[..., Path],
    start: Callable[..., Command],
    tmp_path: Path,
) -> None:
    config = str(configure())
    assert "expected one of motor-1" in refused("grease-renewed", "motor-9", "-c", config)
    assert "no estimate" in refused("grease-renewed", "motor-1", "-c", config)
    kept = {"observer": {"revolutions": 146_916_268.0, "state": [1.0]}, "watch": {"version": 2}}
    with Store.open("", tmp_path / "data") as store:
        store.states.save("motor-1", kept)
    told = ("grease-renewed", "motor-1", "--comment", "regreased", "-c", config)
    ended = cli(*told, "--json")
    assert ended.returncode == 0, ended.stderr
    assert json.loads(ended.stdout) == {"revolutions_before": 146_916_268, "revolutions": 0}
    with Store.open("", tmp_path / "data") as store:
        document = store.states.load("motor-1")
        (line,) = store.audit.page().items
    assert document is not None
    assert document["observer"] == {"revolutions": 0.0, "state": [1.0]}
    assert document["watch"]["version"] == 2
    assert (line.action, line.target, line.detail) == (
        "asset.grease-renewed", "asset motor-1", "comment: regreased",
    )  # fmt: skip
    start("serve", "-c", config)
    assert "POST /api/v1/assets/motor-1/grease-renewed" in refused(*told)


def test_a_damaged_store_is_named_and_salvaged(cli: Cli, tmp_path: Path) -> None:
    config = tmp_path / "bearing-twin.toml"
    config.write_text('[service]\ndata_dir = "var"\nport = 0\n')
    path = tmp_path / "var" / "bearing-twin.db"
    with Store.open("", path.parent) as store:
        store.samples.write([Sample("a", "x", k, 1.0, 192, 0) for k in range(5000)])
        key = create_key(store, "viewer").record.prefix
    content = bytearray(path.read_bytes())
    content[100:4096] = bytes(3996)  # the list of tables
    path.write_bytes(content)
    for command in (("serve",), ("keys", "list"), ("export", "--asset", "a", "--out", "a.csv")):
        refused = cli(*command, "-c", str(config))
        assert refused.returncode == 2
        (line,) = refused.stderr.strip().splitlines()
        assert f"store {path}: damaged (" in line
        assert "'bearing-twin db salvage'" in line
    salvaged = cli("db", "salvage", "-c", str(config), "--json")
    assert salvaged.returncode == 0, salvaged.stderr
    document = json.loads(salvaged.stdout)
    assert document["rows"]["samples"] == 5000
    assert Path(document["kept_as"]).read_bytes() == bytes(content)
    with Store.open("", path.parent) as store:
        # Without the list of tables only the pages are left: names and keys are lost.
        (asset, name) = ("salvaged", "channel-1") if document["unnamed_channels"] else ("a", "x")
        assert store.samples.latest(asset)[name].time_us == 4999
        assert key not in [one.prefix for one in store.access.list_keys()]
    assert "is whole" in cli("db", "salvage", "-c", str(config)).stdout
