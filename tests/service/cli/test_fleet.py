"""What ``bearing-twin fleet identify`` refuses before it computes anything."""

import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest
from site_files import asset_text

pytestmark = pytest.mark.wires

SITE = '[fleet]\nscheduler_ca = "ca.pem"\n' + asset_text("axle-1", ["speed_rpm"], 'family = "old"')


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((), "--all or --family"),
        (("--all", "--family", "old"), "--all or --family"),
        (("--family", "wheel"), "'wheel': no asset has it; expected one of old"),
        (("--all", "--executor", "dask"), "fleet.scheduler: missing"),
        (("--all", "--executor", "process", "--scheduler", "tls://h:1"), "expected none"),
        (("--all", "--scheduler", "tcp://10.0.0.7:8786"), "expected tls://"),
        (("--all", "--scheduler", "http://h"), "expected tls://HOST:PORT"),
    ],
)
def test_what_does_not_fit_is_refused(
    refused: Callable[..., str], tmp_path: Path, arguments: tuple[str, ...], words: str
) -> None:
    (tmp_path / "site.toml").write_text(SITE)
    assert words in refused("fleet", "identify", "-c", "site.toml", *arguments)


def test_a_cluster_is_not_reached_without_all_certificates(
    cli: Callable[..., subprocess.CompletedProcess[str]], tmp_path: Path
) -> None:
    (tmp_path / "site.toml").write_text(SITE)
    ended = cli("fleet", "identify", "--all", "-c", "site.toml", "--scheduler", "tls://h:8786")
    assert ended.returncode == 2
    lines = ended.stderr.splitlines()
    assert [line.split(" ")[1] for line in lines] == [
        "fleet.scheduler_ca",
        "fleet.scheduler_certificate:",
        "fleet.scheduler_key:",
    ]


def test_a_fleet_without_data_is_skipped(
    cli: Callable[..., subprocess.CompletedProcess[str]], tmp_path: Path
) -> None:
    (tmp_path / "site.toml").write_text(SITE)
    ended = cli("fleet", "identify", "--family", "old", "-c", "site.toml")
    assert ended.returncode == 0, ended.stderr
    assert "0 machines identified" in ended.stdout
    assert "1 skipped" in ended.stdout
