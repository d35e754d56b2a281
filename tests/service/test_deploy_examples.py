"""What `deploy/` ships must load, and fit the virtual bench that it says it fits."""

import configparser
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import kubernetes_validate
import pytest
import yaml

from adapters.drivers.can.config import CanChannel, CanSource
from adapters.drivers.modbus.config import ModbusChannel, ModbusPlan, ModbusTcpSource
from adapters.virtual_bench.modbus_server import (
    CONTROLLER_UNIT,
    PLAN_ADDRESS,
    PLAN_ROWS,
    STATUS_ADDRESS,
    TRANSMITTER_UNIT,
)
from adapters.virtual_bench.sensors import PT100_CHANNELS
from service.domain.channels import OPERATING_CHANNELS, RING_SENSORS
from service.site.settings import Settings, load_settings
from service.site.wiring import SourceWiring, wire, wire_assets
from service.waiting import LEAVE_S

DEPLOY = Path(__file__).parents[2] / "deploy"
#: Version whose schemas the manifests are held against.
KUBERNETES = "1.31"
EXAMPLE = DEPLOY / "bearing-twin.example.toml"


@pytest.fixture(scope="module")
def settings() -> Settings:
    return load_settings(EXAMPLE)


@pytest.fixture(scope="module")
def sources(settings: Settings) -> dict[str, SourceWiring]:
    return {source.name: source for source in wire(settings).sources}


def test_the_example_wires_every_sensor_and_the_controller(settings: Settings) -> None:
    assert set(wire(settings).channels["bench-1"]) == {
        *OPERATING_CHANNELS,
        *RING_SENSORS,
        "phase",
        "speed_setpoint_rpm",
        "load_setpoint_n",
    }


def test_the_example_listens_on_loopback_at_real_time(settings: Settings) -> None:
    assert settings.service.host == "127.0.0.1"
    assert settings.clock.rate == 1.0
    assert settings.data_dir == DEPLOY / "var"


def test_the_modbus_side_is_the_virtual_bench_s_register_map(
    sources: dict[str, SourceWiring],
) -> None:
    source = sources["pt100"]
    assert isinstance(source.config, ModbusTcpSource)
    assert (source.config.port, source.config.unit) == (5020, TRANSMITTER_UNIT)
    channels = {}
    for binding in source.channels:
        assert isinstance(binding.config, ModbusChannel)
        channels[binding.channel] = binding.config
    for register, name in enumerate(PT100_CHANNELS):
        channel = channels.pop(name)
        assert (channel.address, channel.kind, channel.scale) == (register, "input", 0.1)
        assert channel.status is not None
        assert channel.status.address == STATUS_ADDRESS + register
    assert {(name, channel.unit_id, channel.address) for name, channel in channels.items()} == {
        ("phase", CONTROLLER_UNIT, 0),
        ("speed_setpoint_rpm", CONTROLLER_UNIT, 2),
        ("load_setpoint_n", CONTROLLER_UNIT, 4),
    }
    (plan,) = source.plans
    assert isinstance(plan.config, ModbusPlan)
    assert (plan.config.unit_id, plan.config.address, plan.config.rows) == (
        CONTROLLER_UNIT,
        PLAN_ADDRESS,
        PLAN_ROWS,
    )


def test_the_can_side_is_the_virtual_bench_s(sources: dict[str, SourceWiring]) -> None:
    source = sources["drive"]
    assert isinstance(source.config, CanSource)
    assert source.config.channel == "socket://127.0.0.1:5021"
    signals = set()
    for binding in source.channels:
        assert isinstance(binding.config, CanChannel)
        signals.add((binding.channel, binding.config.message, binding.config.signal))
    assert signals == {
        ("speed_rpm", "DriveStatus", "Speed"),
        ("load_n", "LoadCell", "RadialLoad"),
    }


def test_the_unit_watches_over_the_service_and_bounds_it() -> None:
    unit = configparser.ConfigParser(strict=False, interpolation=None)
    unit.optionxform = str  # type: ignore[assignment,method-assign]
    unit.read(DEPLOY / "systemd" / "bearing-twin.service")
    service = unit["Service"]
    # `service.service_manager` speaks to it.
    assert (service["Type"], service["WatchdogSec"]) == ("notify", "30")
    # What passes by itself is tried again, without limit; what a person must mend is not.
    assert service["Restart"] == "on-failure"
    assert service["RestartPreventExitStatus"] == "2"
    assert unit["Unit"]["StartLimitIntervalSec"] == "0"
    assert float(service["TimeoutStartSec"]) > LEAVE_S
    assert (service["LimitNOFILE"], service["UMask"]) == ("65536", "0077")
    assert service["MemoryMax"]
    assert service["TasksMax"]


def test_the_page_can_save_where_unit_and_compose_put_the_configuration() -> None:
    unit = configparser.ConfigParser(strict=False, interpolation=None)
    unit.optionxform = str  # type: ignore[assignment,method-assign]
    unit.read(DEPLOY / "systemd" / "bearing-twin.service")
    service = unit["Service"]
    folder = Path(service["ExecStart"].split(" -c ")[1]).parent
    assert service["ProtectSystem"] == "strict"
    assert service["ReadWritePaths"] == f"-{folder}"
    compose = yaml.safe_load((DEPLOY / "compose.yaml").read_text())
    assert f"./config:{folder}" in compose["services"]["bearing-twin"]["volumes"]


def test_the_container_is_watched_and_bounded() -> None:
    compose = yaml.safe_load((DEPLOY / "compose.yaml").read_text())
    service = compose["services"]["bearing-twin"]
    assert service["restart"] == "unless-stopped"
    assert service["healthcheck"]["test"][:3] == ["CMD", "python", "-c"]
    compile(service["healthcheck"]["test"][3], "healthcheck", "exec")
    assert service["mem_limit"]
    assert service["pids_limit"]
    assert service["ulimits"]["nofile"] == 65536
    # What it writes lies on volumes: data, compiled kernels; all else is read-only.
    assert service["read_only"] is True
    assert service["tmpfs"] == ["/tmp"]
    mounted = {volume.split(":")[0] for volume in service["volumes"]}
    assert mounted - {"./config"} == {"data", "cache"} <= compose["volumes"].keys()


def test_cells_are_bounded_and_share_nothing_but_the_kernels() -> None:
    one = yaml.safe_load((DEPLOY / "compose.yaml").read_text())
    several = yaml.safe_load((DEPLOY / "compose.cells.yaml").read_text())
    # Without a profile there is the service alone.
    assert [name for name, of in one["services"].items() if "profiles" not in of] == [
        "bearing-twin"
    ]
    cells = [of for name, of in several["services"].items() if name.startswith("cell-")]
    data = [mount for cell in cells for mount in cell["volumes"] if mount.endswith(":/data")]
    assert len(set(data)) == len(data) == len(cells) >= 2
    for service in (*one["services"].values(), *several["services"].values()):
        if "image" not in service:
            continue  # what is changed of another file
        assert service["restart"] == "unless-stopped"
        assert service["mem_limit"]
    mounted = {
        volume.partition(":")[0]
        for file in (one, several)
        for service in file["services"].values()
        for volume in service.get("volumes", ())
    }
    for name in mounted:
        source = DEPLOY / name
        known = name in one["volumes"] or name in several["volumes"]
        # Folders that whoever deploys makes.
        assert known or source.exists() or name.startswith(("./config", "./secrets")), name


@pytest.fixture(scope="module")
def manifests() -> list[dict[str, Any]]:
    found = []
    for path in sorted((DEPLOY / "kubernetes").glob("*.yaml")):
        if path.name not in ("kustomization.yaml", "secret.yaml"):
            found += list(yaml.safe_load_all(path.read_text()))
    return found


def pods(manifests: list[dict[str, Any]]) -> Iterator[tuple[str, dict[str, Any]]]:
    for one in manifests:
        spec = one.get("spec", {})
        template = spec.get("jobTemplate", {}).get("spec", spec).get("template")
        if template is not None:
            yield one["metadata"]["name"], template


def test_manifests_are_what_kubernetes_takes(manifests: list[dict[str, Any]]) -> None:
    for one in manifests:
        kubernetes_validate.validate(one, KUBERNETES, strict=True)
    wrong = {**manifests[0], "no such key": 1}
    with pytest.raises(kubernetes_validate.ValidationError):
        kubernetes_validate.validate(wrong, KUBERNETES, strict=True)
    folder = DEPLOY / "kubernetes"
    resources = yaml.safe_load((folder / "kustomization.yaml").read_text())["resources"]
    there = {path.name for path in folder.glob("*.yaml")} - {"kustomization.yaml", "secret.yaml"}
    assert there == {name.replace("secret.", "secret.example.") for name in resources}


def test_pods_are_bounded_and_may_do_nothing_else(manifests: list[dict[str, Any]]) -> None:
    config_maps = {
        one["metadata"]["name"]: one["data"] for one in manifests if one["kind"] == "ConfigMap"
    }
    secret = next(one["stringData"] for one in manifests if one["kind"] == "Secret")
    labels = set()
    for name, pod in pods(manifests):
        labels.add(pod["metadata"]["labels"]["app"])
        assert pod["spec"]["securityContext"]["runAsNonRoot"] is True, name
        volumes = {one["name"] for one in pod["spec"].get("volumes", ())}
        for container in (*pod["spec"].get("initContainers", ()), *pod["spec"]["containers"]):
            context = container["securityContext"]
            assert context["readOnlyRootFilesystem"] is True, name
            assert context["allowPrivilegeEscalation"] is False, name
            assert context["capabilities"] == {"drop": ["ALL"]}, name
            assert container["resources"]["limits"]["memory"], name
            assert container["resources"]["requests"].keys() == {"cpu", "memory"}, name
            kept = {one["name"] for one in container.get("volumeMounts", ())}
            assert kept <= volumes | {"data"}, name
            for variable in container.get("env", ()):
                source = variable.get("valueFrom", {})
                if "secretKeyRef" in source:
                    assert source["secretKeyRef"]["key"] in secret, name
                else:  # the name of the pod, or a password from the secret within an address
                    assert "fieldRef" in source or "_PASSWORD)" in variable["value"], name
        for volume in pod["spec"].get("volumes", ()):
            if "configMap" in volume:
                assert volume["configMap"]["name"] in config_maps, name
    # Who is selected is there: budgets, services, policies.
    for one in manifests:
        selector = one.get("spec", {}).get("podSelector", one.get("spec", {}).get("selector", {}))
        match = selector.get("matchLabels", selector)
        app = match.get("app")
        assert app is None or app in labels, one["metadata"]["name"]
    budgets = {
        one["spec"]["selector"]["matchLabels"]["app"]
        for one in manifests
        if one["kind"] == "PodDisruptionBudget"
    }
    assert budgets == {"cell", "web", "nats"}


def test_the_configuration_of_the_cluster_is_right(
    manifests: list[dict[str, Any]], tmp_path: Path
) -> None:
    text = next(
        one["data"]["bearing-twin.toml"]
        for one in manifests
        if one["kind"] == "ConfigMap" and "bearing-twin.toml" in one["data"]
    )
    assert tomllib.loads(text)["service"]["data_dir"] == "/data"
    file = tmp_path / "bearing-twin.toml"
    file.write_text(text.replace('"/data"', '"data"'))
    settings = load_settings(file)
    asset = settings.asset({"id": "axle-1", "template": "axle", "values": {"unit": 1}}, "axle-1")
    assert wire_assets(settings, {"axle-1": asset}).channels["axle-1"]
    web = next(pod for name, pod in pods(manifests) if name == "web")["spec"]["containers"][0]
    assert web["ports"][0]["containerPort"] == settings.service.port
    assert {web[probe]["httpGet"]["path"] for probe in ("livenessProbe", "readinessProbe")} == {
        "/livez",
        "/readyz",
    }
