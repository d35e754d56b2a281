"""Rules and dashboards name what the service measures, and the rules tell when they should."""

import json
import re
import subprocess
from pathlib import Path
from typing import Any

import pytest
import yaml
from patience import patience
from processes import Station, free_port, wait_until
from programs import needed
from site_files import asset_text, write_site

pytestmark = pytest.mark.wires

DEPLOY = Path(__file__).parents[2] / "deploy"
PROMETHEUS, GRAFANA = DEPLOY / "prometheus", DEPLOY / "grafana"
SITE = """
[mqtt]
enabled = true
port = {closed}
[[sources]]
name = "gateway"
driver = "modbus-tcp"
host = "127.0.0.1"
port = {closed}
"""
CHANNELS = (
    't_inner_ring_c = { source = "gateway", register = 0 }\nspeed_rpm = { source = "push" }\n'
)
#: Of Prometheus itself.
UP = "up"


@pytest.fixture(scope="module")
def rules() -> list[dict[str, Any]]:
    document = yaml.safe_load((PROMETHEUS / "rules.yaml").read_text())
    return [rule for group in document["groups"] for rule in group["rules"]]


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> set[str]:
    """Names of all metrics that a service gives, whether they have a value yet or not."""
    folder = tmp_path_factory.mktemp("measured")
    text = SITE.format(closed=free_port()) + asset_text("axle-1", CHANNELS)
    with Station(folder, *write_site(folder, text)) as station:
        station.start_service()

        def metrics() -> str | None:
            # The plant side hands its metrics over a moment after its start.
            text = station.client.get("/metrics").text
            return text if "bearing_twin_publisher_up" in text else None

        text = wait_until(metrics, 60, "the metrics of all sides")
    found = set()
    for name, kind in re.findall(r"^# TYPE (\S+) (\S+)", text, re.MULTILINE):
        found |= {f"{name}_{part}" for part in ("bucket", "sum", "count") if kind == "histogram"}
        found.add(name)
    return found


def names_in(expression: str) -> set[str]:
    return set(re.findall(r"\bbearing_twin_\w+", expression))


def test_every_rule_tells_when_it_should_and_is_silent_otherwise(
    rules: list[dict[str, Any]],
) -> None:
    ran = subprocess.run(
        [needed("prometheus", "promtool"), "test", "rules", "rules_test.yaml"],
        cwd=PROMETHEUS,
        capture_output=True,
        text=True,
        timeout=patience(120),
    )
    assert ran.returncode == 0, ran.stdout + ran.stderr
    tests = yaml.safe_load((PROMETHEUS / "rules_test.yaml").read_text())["tests"]
    cases = [case for test in tests for case in test["alert_rule_test"]]
    for rule in rules:
        of_rule = [case["exp_alerts"] for case in cases if case["alertname"] == rule["alert"]]
        assert any(of_rule), rule["alert"]
        assert not all(of_rule), rule["alert"]


def test_prometheus_takes_its_configuration() -> None:
    ran = subprocess.run(
        [needed("prometheus", "promtool"), "check", "config", "--syntax-only", "prometheus.yml"],
        cwd=PROMETHEUS,
        capture_output=True,
        text=True,
        timeout=patience(120),
    )
    assert ran.returncode == 0, ran.stdout + ran.stderr
    compose = yaml.safe_load((DEPLOY / "compose.yaml").read_text())
    scrape = yaml.safe_load((PROMETHEUS / "prometheus.yml").read_text())["scrape_configs"][0]
    assert scrape["basic_auth"]["password_file"] == "/run/secrets/metrics_key"
    assert compose["services"]["prometheus"]["secrets"] == ["metrics_key"]
    (target,) = scrape["static_configs"][0]["targets"]
    assert target.partition(":")[0] in compose["services"]


def test_rules_and_dashboards_name_metrics_that_there_are(
    rules: list[dict[str, Any]], measured: set[str]
) -> None:
    for rule in rules:
        names = names_in(rule["expr"])
        assert names <= measured, rule["alert"]
        assert names or rule["expr"].startswith(f"{UP}{{"), rule["alert"]
    shown = set()
    for path in sorted(GRAFANA.glob("*.json")):
        board = json.loads(path.read_text())
        numbers = [panel["id"] for panel in board["panels"]]
        assert len(numbers) == len(set(numbers))
        for panel in board["panels"]:
            for target in panel["targets"]:
                assert names_in(target["expr"]), panel["title"]
                shown |= names_in(target["expr"])
        for variable in board["templating"]["list"]:
            shown |= names_in(str(variable.get("definition", "")))
    assert shown <= measured, shown - measured
