"""Lists of assets on the command line, whether the service runs or not."""

import json
import re
import subprocess
from collections.abc import Callable
from pathlib import Path

import httpx2
import pytest
from patience import patience
from processes import wait_until

from adapters.samples import Sample
from service.store import Store

pytestmark = pytest.mark.wires

PAGE = Path(__file__).parents[4] / "docs" / "connect" / "many-assets.md"
Cli = Callable[..., "subprocess.CompletedProcess[str]"]
Configure = Callable[..., Path]

TEMPLATE = """
[[templates]]
name = "motor"
bearing = "{bearing}"
low_risk = { speed_rpm_max = 4300, load_n_max = 3400 }
values = { bearing = "6311" }
group = "Line {line}"
[templates.channels]
speed_rpm = { source = "push" }
load_n = { source = "push" }
ambient_c = { source = "push" }
t_inner_ring_c = { source = "push" }
"""
GOOD = "id;template;name;line\nm-1;motor;Größe 1;1\nm-2;motor;;2\n"
WRONG = GOOD + "m-3;motor;;\nm-4;motr;;4\nmotor-1;motor;;5\n"


@pytest.fixture
def config(configure: Configure, asset: str) -> str:
    return str(configure(asset + TEMPLATE))


def stored(tmp_path: Path) -> dict[str, object]:
    with Store.open("", tmp_path / "data") as store:
        return {one.id: one.table for one in store.assets.present()}


def trail(tmp_path: Path) -> list[tuple[str, str, str, str]]:
    with Store.open("", tmp_path / "data") as store:
        return [(one.who, one.action, one.target, one.detail) for one in store.audit.page().items]


def test_a_list_goes_in_and_comes_out(cli: Cli, config: str, tmp_path: Path) -> None:
    (tmp_path / "fleet.csv").write_text(GOOD, encoding="utf-8-sig")
    tried = cli("assets", "import", "fleet.csv", "-c", config, "--dry-run", "--json")
    assert json.loads(tried.stdout) == {
        "created": 2,
        "changed": 0,
        "unchanged": 0,
        "rejected": [],
        "dry_run": True,
    }
    assert (stored(tmp_path), trail(tmp_path)) == ({}, [])
    done = cli("assets", "import", "fleet.csv", "-c", config)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout == "fleet.csv: 2 created, 0 changed, 0 unchanged.\n"
    expected = {
        "m-1": {"template": "motor", "name": "Größe 1", "values": {"line": 1}},
        "m-2": {"template": "motor", "values": {"line": 2}},
    }
    assert stored(tmp_path) == expected
    ((who, action, _, detail),) = trail(tmp_path)
    assert who.startswith("command line, ")
    assert (action, detail) == ("assets.import", "created: 2; changed: 0; assets: m-1, m-2")
    again = cli("assets", "import", "fleet.csv", "-c", config)
    assert again.stdout == "fleet.csv: 0 created, 0 changed, 2 unchanged.\n"
    assert len(trail(tmp_path)) == 1, "what changes nothing writes nothing"

    listed = json.loads(cli("assets", "list", "-c", config, "--json").stdout)["assets"]
    assert [(one["id"], one["origin"], one["template"]) for one in listed] == [
        ("motor-1", "file", None),
        ("m-1", "provisioned", "motor"),
        ("m-2", "provisioned", "motor"),
    ]
    assert "Größe 1" in cli("assets", "list", "-c", config).stdout

    for name in ("out.csv", "out.json"):
        exported = cli("assets", "export", name, "-c", config)
        assert (exported.returncode, exported.stdout) == (0, f"{name}: 2 assets.\n")
    printed = cli("assets", "export", "-c", config).stdout
    assert printed == (tmp_path / "out.json").read_text()
    removed = cli("assets", "remove", "m-1", "m-2", "-c", config, "--json")
    assert json.loads(removed.stdout) == {"removed": ["m-1", "m-2"]}
    assert stored(tmp_path) == {}
    assert trail(tmp_path)[0][1:3] == ("assets.remove", "asset m-1, asset m-2")
    for name in ("out.csv", "out.json"):
        assert cli("assets", "import", name, "-c", config).returncode == 0
        assert stored(tmp_path) == expected
        cli("assets", "remove", "m-1", "m-2", "-c", config)


def test_one_line_for_each_wrong_row_and_nothing_is_written(
    cli: Cli, config: str, tmp_path: Path
) -> None:
    (tmp_path / "fleet.csv").write_text(WRONG)
    for options in ((), ("--json",), ("--dry-run",)):
        refused = cli("assets", "import", "fleet.csv", "-c", config, *options)
        assert (refused.returncode, refused.stdout) == (2, "")
        assert refused.stderr.splitlines() == [
            "bearing-twin: fleet.csv: row 4 (m-3): values.line: missing; "
            "template 'motor' asks for it",
            "bearing-twin: fleet.csv: row 5 (m-4): template = 'motr': did you mean 'motor'?",
            "bearing-twin: fleet.csv: row 6 (motor-1): stands in the configuration file; "
            "expected another id, or a change there",
            "bearing-twin: fleet.csv: nothing is changed",
        ]
    assert (stored(tmp_path), trail(tmp_path)) == ({}, [])
    taken = cli("assets", "import", "fleet.csv", "-c", config, "--partial", "--json")
    assert taken.returncode == 2, "as a file of samples with rows that are not taken"
    document = json.loads(taken.stdout)
    assert (document["created"], [one["row"] for one in document["rejected"]]) == (2, [4, 5, 6])
    assert len(taken.stderr.splitlines()) == 3
    assert set(stored(tmp_path)) == {"m-1", "m-2"}


@pytest.mark.parametrize(
    ("name", "content", "expected"),
    [
        ("fleet.csv", None, "fleet.csv: cannot be read"),
        ("fleet.txt", GOOD, "fleet.txt: expected a name that ends in .csv or .json"),
        ("fleet.csv", "", "fleet.csv: assets: line 1: empty file"),
        ("fleet.csv", "name\nx\n", "fleet.csv: line 1: missing column 'id'"),
        ("fleet.json", "{", "fleet.json: not valid JSON"),
        ("fleet.json", "[]", 'fleet.json: expected {"assets"'),
    ],
)
def test_a_file_that_is_no_list_is_refused(
    refused: Callable[..., str], config: str, tmp_path: Path, name: str, content: str, expected: str
) -> None:
    if content is not None:
        (tmp_path / name).write_text(content)
    assert expected in refused("assets", "import", name, "-c", config)


def test_what_cannot_be_removed_or_written_is_named(
    cli: Cli, refused: Callable[..., str], config: str, tmp_path: Path
) -> None:
    own = {"id": "m-1", "template": "motor", "values": {"line": 1}, "verdict": {}}
    (tmp_path / "fleet.json").write_text(json.dumps({"assets": [own]}))
    assert cli("assets", "import", "fleet.json", "-c", config).returncode == 0
    line = refused("assets", "export", "fleet.csv", "-c", config)
    assert "m-1.verdict: CSV cannot hold it; expected a file that ends in .json" in line
    assert not (tmp_path / "fleet.csv").exists()
    assert "cannot be written" in refused("assets", "export", "no/such/fleet.json", "-c", config)
    both = cli("assets", "remove", "m-1", "motor-1", "m-9", "-c", config)
    assert (both.returncode, both.stdout) == (2, "")
    assert [line.partition(": ")[2].partition(";")[0] for line in both.stderr.splitlines()] == [
        "motor-1: stands in the configuration file",
        "m-9: no such asset is provisioned",
    ]
    assert set(stored(tmp_path)) == {"m-1"}, "all or nothing"


def test_other_commands_know_provisioned_assets(
    cli: Cli, refused: Callable[..., str], config: str, tmp_path: Path
) -> None:
    unknown = refused("import", "rows.csv", "--asset", "m-1", "-c", config)
    assert "--asset m-1: no such asset; expected one of motor-1" in unknown
    assert not (tmp_path / "data" / "bearing-twin.db").exists(), "a look makes no store"
    (tmp_path / "fleet.csv").write_text(GOOD)
    assert cli("assets", "import", "fleet.csv", "-c", config).returncode == 0
    columns = "time,speed_rpm,load_n,ambient_c,t_inner_ring_c,t_outer_ring_c"
    (tmp_path / "rows.csv").write_text(f"{columns}\n2026-11-20T08:00:00Z,1000,2000,23,41,40\n")
    brought = cli("import", "rows.csv", "--asset", "m-1", "-c", config)
    assert (brought.returncode, brought.stderr) == (0, "")
    with Store.open("", tmp_path / "data") as store:
        assert store.samples.counts(1000)["m-1", "speed_rpm"] == 1
        store.samples.write([Sample("m-2", "load_n", 1, 1.0, 192, 1)])
        store.states.save("m-1", {"observer": {"revolutions": 5.0}})
    assert cli("export", "--out", "out.csv", "--asset", "m-2", "-c", config).returncode == 0
    unknown = refused("grease-renewed", "m-9", "-c", config)
    assert "m-9: no such asset; expected one of motor-1, m-1, m-2" in unknown
    assert cli("grease-renewed", "m-1", "-c", config).returncode == 0
    other = ("identify", "rows.csv", "--config", config, "--out", "model.json", "--asset")
    assert f"--asset 'm-9': expected one of the assets of {config} (motor-1, m-1, m-2)" in refused(
        *other, "m-9"
    )
    assert "'6310': expected '6311', the bearing of asset 'm-1'" in refused(
        *other, "m-1", "--bearing", "6310"
    )


def test_a_running_service_follows_what_the_command_line_changes(
    cli: Cli, config: str, tmp_path: Path, start: Callable[..., object], port: int
) -> None:
    key = cli("keys", "create", "--role", "engineer", "-c", config).stdout.strip()
    start("serve", "-c", config)
    with httpx2.Client(
        base_url=f"http://127.0.0.1:{port}/api/v1", headers={"X-API-Key": key}, timeout=patience(60)
    ) as client:

        def present() -> list[str]:
            try:
                answer = client.get("/assets")
            except httpx2.TransportError:
                return []
            return [one["id"] for one in answer.json()["items"]] if answer.is_success else []

        wait_until(lambda: present() == ["motor-1"], 60, "the asset of the file")
        (tmp_path / "fleet.csv").write_text(GOOD)
        assert cli("assets", "import", "fleet.csv", "-c", config).returncode == 0
        wait_until(lambda: present() == ["motor-1", "m-1", "m-2"], 60, "the provisioned assets")
        assert client.get("/assets/m-1").json()["name"] == "Größe 1"
        (tmp_path / "fleet.csv").write_text(GOOD.replace("Größe 1", "first"))
        assert cli("assets", "import", "fleet.csv", "-c", config).returncode == 0
        wait_until(
            lambda: client.get("/assets/m-1").json().get("name") == "first", 60, "the other name"
        )
        assert cli("assets", "remove", "m-2", "-c", config).returncode == 0
        wait_until(lambda: present() == ["motor-1", "m-1"], 60, "the removal")
        document = client.get("/assets/m-1/configuration").json()
        assert (document["origin"], document["not_running"]) == ("provisioned", None)


def test_the_commands_of_the_page_do_as_it_says(
    cli: Cli, configure: Configure, tmp_path: Path
) -> None:
    page = PAGE.read_text()
    (configuration,) = re.findall(r"^```toml\n(.*?)^```", page, re.DOTALL | re.MULTILINE)
    (fleet,) = re.findall(r"^```\n(id,.*?)^```", page, re.DOTALL | re.MULTILINE)
    (commands,) = re.findall(r"^```sh\n(.*?)^```", page, re.DOTALL | re.MULTILINE)
    configure(configuration)
    (tmp_path / "fleet.csv").write_text(fleet)
    printed = []
    for command in commands.splitlines():
        ended = cli(*command.split()[1:])
        assert (ended.returncode, ended.stderr) == (0, ""), command
        printed.append(ended.stdout)
    assert printed[0] == "fleet.csv: 3 created, 0 changed, 0 unchanged.\n"
    assert "spare-1" in printed[1]
    assert (tmp_path / "now.csv").read_text().splitlines()[1:] == [
        'axle-1,axle,"Car 1, axle 1",,11',
        'axle-2,axle,"Car 1, axle 2",,12',
        'axle-3,axle,"Car 2, axle 1",8,13',
    ]
    assert list(stored(tmp_path)) == ["axle-1"]
