"""The calls with curl on all pages and in the README, run as they are printed."""

import os
import random
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx2
import pytest
from patience import patience
from processes import Site, wait_until
from receivers import running_hook

from service.clock import wall_us
from service.demo.configuration import ASSET
from service.jobs.models import first_model
from service.site.settings import load_settings
from service.store import FirstModel

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
#: Blocks that need more than a service, by a text in them, and where they are run.
ELSEWHERE = {
    "npx node-red": "tests/foreign/test_node_red.py",
    "--cacert server.pem": "needs the certificate that it makes; tests/service/security has TLS",
}
#: What is printed to be refused, by a text in the call.
REFUSED = {'"speed_rpm": 30000': 422}
ADDRESS = "http://127.0.0.1:8080/api/v1"
_BLOCK = re.compile(r"^```(?:bash|sh)\n(.*?)^```|((?:^    [^\n]*\n)+)", re.DOTALL | re.MULTILINE)
#: Notes each call and its status, and gives the block the answer.
_CURL = """#!/bin/sh
PATH=$REAL_PATH curl "$@" --no-progress-meter -w '%{stderr}STATUS %{http_code}' 2>"$0.status"
code=$?
status=$(sed -n 's/.*STATUS //p' "$0.status")
echo "$status $*" | tr '\\n' ' ' >> "$0.log"
echo >> "$0.log"
exit $code
"""
_COMMAND = """#!/bin/sh
exec {python} -m service "$@"
"""
_MORE = """
[[notifications]]
id = "control-room"
kind = "webhook"
url = "{hook}"
"""


def blocks() -> list[tuple[str, str]]:
    """Each printed block that calls the service, with its page."""
    found = []
    for page in PAGES:
        for match in _BLOCK.finditer(page.read_text()):
            block = match[1] or re.sub("(?m)^    ", "", match[2])
            if "curl " in block and not any(text in block for text in ELSEWHERE):
                found.append((page.name, block))
    return found


BLOCKS = blocks()


class Printed(Site):
    """A virtual bench and a service that has what the pages speak of."""

    def __init__(self, folder: Path, hook: str) -> None:
        super().__init__(folder, "staircase", 60.0, pushed="t_node_5_c")
        page = (ROOT / "docs" / "connect" / "many-assets.md").read_text()
        configuration = re.search(r"^```toml\n(.*?)^```", page, re.DOTALL | re.MULTILINE)
        assert configuration is not None
        text = self.configuration.read_text() + _MORE.format(hook=hook) + configuration[1]
        self.configuration.write_text(text)
        (folder / "site.toml").symlink_to(self.configuration)
        settings = load_settings(self.configuration)
        with self.open_store() as store:
            asset = next(one for one in settings.assets if one.id == ASSET)
            document: Any = first_model(asset)
            trained = document["posterior"]["trained"] | {"minutes": 60}
            document |= {"posterior": document["posterior"] | {"trained": trained}}
            store.models.begin({ASSET: FirstModel(document, "for the test")}, "test", wall_us())
        programs = folder / "programs"
        programs.mkdir()
        for name, text in (
            ("curl", _CURL),
            ("bearing-twin", _COMMAND.format(python=sys.executable)),
        ):
            (programs / name).write_text(text)
            (programs / name).chmod(0o755)
        self.log = programs / "curl.log"
        path = os.environ["PATH"]
        self.environment = os.environ | {
            "PATH": f"{programs}:{path}",
            "REAL_PATH": path,
            "B": f"http://127.0.0.1:{self.port}/api/v1",
            "KEY": self.key,
        }

    def run(self, block: str) -> list[tuple[int, str]]:
        """Run a block in a shell of its own; the status of each call."""
        if "/identifications" in block:  # the service begins jobs automatically, one at a time
            wait_until(self.is_idle, 180, "the end of the automatic identification")
        self.log.write_text("")
        block = block.replace(ADDRESS, self.environment["B"])
        ran = subprocess.run(
            ["bash", "-eu", "-c", block],
            cwd=self.folder,
            env=self.environment,
            capture_output=True,
            text=True,
            timeout=patience(300),
            check=False,
        )
        lines = [line.partition(" ") for line in self.log.read_text().splitlines()]
        calls = [(int(status or 0), call) for status, _, call in lines]
        assert ran.returncode == 0, (calls[-1:], ran.stdout[-500:], ran.stderr[-1500:])
        return calls

    def is_idle(self) -> bool:
        """Whether no job is queued or runs."""
        jobs = self.get(f"/api/v1/assets/{ASSET}/identifications")["items"]
        return all(job["status"] not in ("queued", "running") for job in jobs)

    def has_all(self) -> bool:
        """Whether there is a forecast, a run, and an alarm that is normal."""
        base = f"/api/v1/assets/{ASSET}"
        return (
            self.client.get(f"{base}/forecast").is_success
            and bool(self.get(f"{base}/runs")["items"])
            and bool(self.get("/api/v1/alarms", state="NORM")["items"])
            and bool(self.get(f"{base}/windows")["items"])
        )


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Printed]:
    with running_hook() as hook, Printed(tmp_path_factory.mktemp("printed"), hook.url) as site:
        site.start_bench()
        site.start_service()
        wait_until(site.has_all, 180, "what the pages speak of")
        yield site


@pytest.mark.wires
@pytest.mark.thorough
@pytest.mark.timeout(900)
@pytest.mark.parametrize(
    ("page", "block"),
    # Any order will do: another one with each change of a page, the same one on each machine.
    random.Random("".join(block for _, block in BLOCKS)).sample(BLOCKS, len(BLOCKS)),
    ids=lambda value: value if value.endswith(".md") else "",
)
def test_what_is_printed_works(site: Printed, page: str, block: str) -> None:
    calls = site.run(block)
    assert calls, "no call was noted"
    for status, call in calls:
        expected = next((code for text, code in REFUSED.items() if text in call), None)
        assert status == expected if expected else 200 <= status < 400, (page, status, call)


def test_all_pages_write_calls_in_the_same_way() -> None:
    assert len({page for page, _ in BLOCKS}) >= 10
    for page, block in BLOCKS:
        assert not re.search(r"\b20\d\d-\d\d-\d\d", block), f"{page}: a date that passes: {block}"
        assert re.findall(r"\$\{?(?:URL|K|A)\b", block) == [], f"{page}: B and KEY: {block}"
        keys = re.findall(r'"[^"\n]*\$\{?KEY[^"\n]*"', block)
        assert {one for one in keys if "\\" not in one} <= {'"X-API-Key: $KEY"'}, (page, keys)
        assert not re.search(r"/ID\b|\bFILE\b|bt_\.", block), f"{page}: a hole: {block}"
    for path in PAGES:
        if path.name in {page for page, _ in BLOCKS} - {"README.md", "api.md"}:
            assert re.search(r"\[api\.md\]\(\S*api\.md\)", path.read_text()), path


def test_what_is_run_elsewhere_is_there() -> None:
    pages = "".join(page.read_text() for page in PAGES)
    assert all(text in pages for text in ELSEWHERE)
    assert httpx2.URL(ADDRESS).port == 8080
