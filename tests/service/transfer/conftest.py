"""Import and export by the command line's functions, on a store with one asset."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from site_files import asset_text
from typer.testing import CliRunner

from service.cli.main import app
from service.store import Store

Run = Callable[..., tuple[int, dict[str, Any], str]]
CONFIG = (
    '[service]\ndata_dir = "data"\n'
    + asset_text("a", ["t_inner_ring_c"], 'network = "bearing-14"')
    + "[assets.limits]\nt_inner_ring_c = { warning = 70, alarm = 95 }\n"
)


@pytest.fixture
def config(tmp_path: Path) -> Path:
    path = tmp_path / "c.toml"
    path.write_text(CONFIG)
    return path


@pytest.fixture
def run(config: Path) -> Run:
    def run(*arguments: object) -> tuple[int, dict[str, Any], str]:
        texts = [str(one) for one in arguments]
        result = CliRunner().invoke(app, [*texts, "-c", str(config), "--asset", "a", "--json"])
        if isinstance(result.exception, ValueError):
            assert type(result.exception).__module__.startswith(("service.", "adapters."))
            assert "\n" not in str(result.exception)
            return 2, {}, str(result.exception)
        assert result.exception is None or isinstance(result.exception, SystemExit), result
        return result.exit_code, json.loads(result.stdout), result.stderr

    return run


def stored(tmp_path: Path) -> list[tuple[str, int, float | None, int]]:
    with Store.open("", tmp_path / "data") as store:
        rows = store.samples.read("a", None, 0, 2**62, 10**6)
    return [(row.channel, row.time_us, row.value, row.quality) for row in rows]
