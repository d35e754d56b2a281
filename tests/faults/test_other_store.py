"""The address of the store leads to an older copy, as after a failover to a standby that lagged."""

import subprocess
import sys
from pathlib import Path

import httpx2
import pytest
from patience import patience
from postgresql import running_postgresql
from processes import Station, wait_until
from site_files import OBSERVE, asset_text, write_site

from service.clock import from_rfc3339, rfc3339

pytestmark = [pytest.mark.wires, pytest.mark.timeout(300)]
PATIENCE_S = 60.0
ASSETS = ("a1", "a2", "a3", "a4")
FIRST_US = from_rfc3339("2026-01-01T00:00:00Z")


class Site(Station):
    """Four machines to which everything is pushed."""

    def push_at(self, asset: str, value: float) -> int:
        moment = rfc3339(FIRST_US + round(value * 1e6))
        one = {"channel": "t_inner_ring_c", "time": moment, "value": value}
        path = f"/api/v1/assets/{asset}/measurements"
        return self.client.post(path, json={"samples": [one]}).status_code

    def history(self, asset: str) -> list[float]:
        answer = self.get(
            f"/api/v1/assets/{asset}/measurements",
            start="2026-01-01T00:00:00Z",
            end="2026-01-02T00:00:00Z",
            channel="t_inner_ring_c",
        )
        return [one["value"] for one in answer["items"]]

    def doubts(self, what: str) -> bool:
        check = self.check("store")
        return check["status"] == "degraded" and what in (check["detail"] or "")

    def store_is(self, status: str) -> bool:
        return bool(self.check("store")["status"] == status)


@pytest.mark.endurance
def test_no_machine_gets_samples_of_another_and_a_person_says_when_to_go_on(
    tmp_path: Path,
) -> None:
    with running_postgresql() as server:
        text = "".join(asset_text(name, ["t_inner_ring_c"], OBSERVE) for name in ASSETS)
        url = f'database_url = "{server.database()}"'
        with Site(tmp_path, *write_site(tmp_path, text, url)) as site:
            site.start_service()
            wait_until(lambda: site.store_is("ok"), PATIENCE_S, "a store")
            assert (site.push_at("a1", 101), site.push_at("a4", 401)) == (200, 200)
            copy = server.folder / "copy"
            server.copy(copy)
            wait_until(lambda: site.push_at("a2", 201) == httpx2.codes.OK, PATIENCE_S, "pushed")
            wait_until(lambda: site.history("a2") == [201.0], PATIENCE_S, "stored")
            server.fail_over(copy)
            # Whatever the order: each of them is acknowledged, and waits.
            for asset, value in (("a2", 202), ("a3", 300), ("a2", 203), ("a3", 301)):
                assert site.push_at(asset, value) == httpx2.codes.OK
            # At first it is the server that cannot be reached.
            wait_until(lambda: site.doubts("an older copy"), PATIENCE_S, "doubt")
            assert "'bearing-twin db confirm'" in site.check("store")["detail"]
            assert (site.history("a2"), site.history("a3")) == ([], [])
            assert site.service is not None
            assert "older copy" in site.service.log.read_text()
            # It says so after a new start, too, and keeps what it has accepted.
            site.service.kill()
            site.start_service()
            wait_until(lambda: site.doubts("an older copy"), PATIENCE_S, "doubt")
            confirm = [
                sys.executable,
                "-m",
                "service",
                "db",
                "confirm",
                "-c",
                str(site.configuration),
            ]
            subprocess.run(confirm, check=True, timeout=patience(PATIENCE_S))
            wait_until(lambda: site.store_is("ok"), PATIENCE_S, "confirmed")
            assert site.push_at("a3", 302) == httpx2.codes.OK
            wait_until(lambda: site.history("a3") == [300, 301, 302], PATIENCE_S, "stored")
            assert site.history("a2") == [202, 203], "201 is with the server that was left"
            assert site.history("a1") == [101]
            assert site.history("a4") == [401]
            with site.open_store() as store:
                assert "store.confirm" in [one.action for one in store.audit.page().items]
