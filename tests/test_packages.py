"""The wheel and the source archive, built here and looked into; what is installed with them."""

import json
import os
import re
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from pathlib import Path, PurePosixPath

import pytest
import yaml
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from patience import patience

from service import __version__
from tools.bill_of_materials import BILL, LOCK, SHIPPED, documents, locked

ROOT = Path(__file__).parent.parent
EXAMPLE = "bearing-twin.example.toml"


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with both."""
    out = tmp_path_factory.mktemp("packages")
    build(ROOT, out)
    return out


def build(folder: Path, out: Path) -> None:
    command = [sys.executable, "-m", "hatchling", "build", "--directory", str(out)]
    ran = subprocess.run(
        command, cwd=folder, capture_output=True, text=True, timeout=patience(240), check=False
    )
    assert ran.returncode == 0, ran.stderr


def unpacked(wheels: Path, into: Path) -> list[str]:
    """Unpack the one wheel of a folder; gives the names of its files."""
    (wheel,) = wheels.glob("*.whl")
    with zipfile.ZipFile(wheel) as opened:
        opened.extractall(into)
        return opened.namelist()


def bearing_twin(
    folder: Path, *arguments: str, installed: tuple[Path, ...]
) -> "subprocess.CompletedProcess[str]":
    """Run a command with these folders in the place of what is installed."""
    return subprocess.run(
        [sys.executable, "-m", "service", *arguments],
        cwd=folder,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(map(str, installed))},
        capture_output=True,
        text=True,
        timeout=patience(240),
        check=False,
    )


#: What the image is installed with.
EXTRAS = ("fleet", "mqtt", "opcua", "report")
STATIC = ROOT / "service" / "web" / "pages" / "static"


@pytest.fixture(scope="module")
def sources(built: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The source archive, unpacked."""
    folder = tmp_path_factory.mktemp("sources")
    (archive,) = built.glob("*.tar.gz")
    with tarfile.open(archive) as opened:
        opened.extractall(folder, filter="data")
    (inside,) = folder.iterdir()
    return inside


def inputs_of(dockerfile: str) -> set[str]:
    """What an image is built from."""
    return {
        source
        for line in re.findall(r"^COPY (?!--from)(.*)$", dockerfile, re.MULTILINE)
        for source in line.split()[:-1]
    }


@pytest.mark.wires
def test_the_source_archive_has_what_its_compose_file_builds(sources: Path) -> None:
    compose = yaml.safe_load((sources / "deploy" / "compose.yaml").read_text())
    build = compose["services"]["bearing-twin"]["build"]
    context = (sources / "deploy" / build["context"]).resolve()
    needed = inputs_of((context / build.get("dockerfile", "Dockerfile")).read_text())
    assert {"pyproject.toml", "service", f"deploy/{EXAMPLE}"} <= needed
    ignored = (context / ".dockerignore").read_text().splitlines()
    for one in needed:
        assert (context / one).exists(), f"{one} is not in the archive"
        parts = PurePosixPath(one).parents
        kept = {one, *(str(parent) for parent in parts)}
        assert any(f"!{name}" in ignored for name in kept), f"{one} is outside the context"
    # A wheel of what the image has.
    forced = re.search(r'^"(deploy/[^"]+)" = ', (sources / "pyproject.toml").read_text(), re.M)
    assert forced is not None
    assert forced[1] in needed


@pytest.mark.wires
def test_the_source_archive_has_what_the_pages_and_the_makefile_name(sources: Path) -> None:
    for page in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md"):
        for target in re.findall(r"\]\(([^)#\s]+)", (sources / page).read_text()):
            assert "://" in target or (sources / target).exists(), f"{page}: {target}"
    for name in ("LICENSE", "SECURITY.md", "Makefile", "constraints.txt", "tests", "tools"):
        assert (sources / name).exists(), name


@pytest.mark.wires
def test_the_wheel_writes_the_example_that_its_readme_names(built: Path, tmp_path: Path) -> None:
    installed, folder = tmp_path / "installed", tmp_path / "folder"
    folder.mkdir()
    unpacked(built, installed)
    assert "`bearing-twin example`" in (ROOT / "README.md").read_text()

    def run(*arguments: str) -> "subprocess.CompletedProcess[str]":
        return bearing_twin(folder, *arguments, installed=(installed,))

    ran = run("example")
    assert (ran.returncode, ran.stdout.split()) == (0, [EXAMPLE, "bench.dbc"]), ran.stderr
    assert (folder / EXAMPLE).read_bytes() == (ROOT / "deploy" / EXAMPLE).read_bytes()
    assert run("modbus-map", "-c", EXAMPLE).returncode == 0, "it can be read"
    again = run("example")
    assert again.returncode == 2
    assert "is there already" in again.stderr
    assert "expected an existing folder" in run("example", "gone").stderr


@pytest.mark.wires
def test_the_laboratory_is_in_its_own_wheel_and_brings_its_commands(
    built: Path, tmp_path: Path
) -> None:
    product, laboratory, folder = (tmp_path / name for name in ("product", "laboratory", "folder"))
    folder.mkdir()
    build(ROOT / "laboratory", tmp_path / "wheels")
    theirs = unpacked(tmp_path / "wheels", laboratory)
    ours = unpacked(built, product)
    tops = {PurePosixPath(name).parts[0] for name in ours}
    assert {top for top in tops if not top.endswith(".dist-info")} == {
        "service",
        "twin_core",
        "adapters",
    }
    own = {str(file.relative_to(ROOT)) for file in (ROOT / "service").rglob("*.py")}
    assert own <= set(ours), "all of the product"
    files = (ROOT / "laboratory").rglob("bearing_twin_laboratory/**/*.py")
    assert {str(file.relative_to(ROOT / "laboratory")) for file in files} <= set(theirs)

    for command in ("study", "benchmark", "demo-fleet"):
        ran = bearing_twin(folder, command, "--help", installed=(product, laboratory))
        assert ran.returncode == 0, ran.stderr
        assert f"bearing-twin {command}" in ran.stdout.replace("python -m service", "bearing-twin")
    ran = bearing_twin(folder, "study", "none", installed=(product, laboratory))
    assert (ran.returncode, ran.stderr.count("\n")) == (2, 1), ran.stderr
    assert "study 'none': expected one of simple-network," in ran.stderr


@pytest.mark.wires
@pytest.mark.parametrize("command", ["study", "benchmark", "demo-fleet"])
def test_without_the_laboratory_a_command_of_it_names_what_to_install(
    built: Path, tmp_path: Path, command: str
) -> None:
    product, empty = tmp_path / "product", tmp_path / "empty"
    unpacked(built, product)
    # Of two distributions of a name the first is the one that counts; this one brings nothing.
    (empty / "bearing_twin_laboratory-0.dist-info").mkdir(parents=True)
    (empty / "bearing_twin_laboratory-0.dist-info" / "METADATA").write_text(
        "Metadata-Version: 2.4\nName: bearing-twin-laboratory\nVersion: 0\n"
    )
    ran = bearing_twin(tmp_path, command, "--json", installed=(empty, product))
    assert (ran.returncode, ran.stdout) == (2, "")
    assert ran.stderr == (
        f"bearing-twin: {command}: a command of the laboratory, which is not installed; expected, "
        "in a checkout of Bearing Twin: pip install --editable laboratory\n"
    )
    ran = bearing_twin(tmp_path, "--help", installed=(empty, product))
    assert ran.returncode == 0
    assert f" {command} " not in ran.stdout


@pytest.mark.wires
def test_both_are_rebuilt_to_the_same_bytes(built: Path, sources: Path, tmp_path: Path) -> None:
    """From the source archive, in another folder, with other times of its files."""
    for number, file in enumerate(sources.rglob("*")):
        os.utime(file, (number, number))
    command = [sys.executable, "-m", "hatchling", "build", "--directory", str(tmp_path)]
    subprocess.run(command, cwd=sources, capture_output=True, timeout=patience(240), check=True)
    first, again = sorted(built.iterdir()), sorted(tmp_path.iterdir())
    assert [file.name for file in first] == [file.name for file in again]
    assert len(first) == 2
    for one, other in zip(first, again, strict=True):
        assert one.read_bytes() == other.read_bytes(), one.name


@pytest.mark.wires
def test_the_wheel_carries_its_bill_of_materials(built: Path) -> None:
    (wheel,) = built.glob("*.whl")
    with zipfile.ZipFile(wheel) as opened:
        (name,) = [one for one in opened.namelist() if ".dist-info/sboms/" in one]
        assert opened.read(name) == BILL.read_bytes()
        files = opened.namelist()
    for part in SHIPPED:
        assert any(file.startswith(part.path) for file in files), part
    assert name == f"bearing_twin-{__version__}.dist-info/sboms/{BILL.name}"


def test_the_bill_of_materials_is_that_of_the_lock() -> None:
    for file, text in documents().items():
        assert file.read_text() == text, f"{file.name}: 'make lock' writes it"
    bill = json.loads(BILL.read_text())
    assert bill["metadata"]["component"]["version"] == __version__
    parts = {one["bom-ref"]: one for one in bill["components"]}
    assert len(parts) == len(bill["components"])
    assert all(one["licenses"][0]["expression"] for one in parts.values())
    needs = {one["ref"]: one["dependsOn"] for one in bill["dependencies"]}
    reached, waiting = set(), [bill["metadata"]["component"]["bom-ref"]]
    while waiting:
        waiting += set(needs.get(ref := waiting.pop(), ())) - reached
        reached.add(ref)
    assert reached - {bill["metadata"]["component"]["bom-ref"]} == set(parts)


def test_every_foreign_file_of_the_page_is_in_the_bill() -> None:
    foreign = [*(STATIC / "vendor").glob("*.js"), *(STATIC / "fonts").glob("*.woff2")]
    assert foreign
    for file in foreign:
        path = file.relative_to(ROOT).as_posix()
        assert any(path.startswith(one.path) for one in SHIPPED), f"{path}: name it in SHIPPED"


def test_the_lock_has_what_the_product_needs_with_hashes() -> None:
    text = LOCK.read_text()
    packages = {one.name: one.version for one in locked(text)}
    assert "://" not in text, "no address of an index"
    blocks = re.split(r"^(?=\S)", text, flags=re.MULTILINE)[1:]
    assert len(blocks) == len(packages)
    assert all("--hash=sha256:" in block for block in blocks)
    lines = (ROOT / "constraints.txt").read_text().splitlines()
    pinned = (line.partition("==") for line in lines if "==" in line)
    tested = {canonicalize_name(name): version for name, _, version in pinned}
    assert {name: tested[name] for name in packages} == packages, "what the tests run with"
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = [line for name in EXTRAS for line in project["optional-dependencies"][name]]
    assert "'.[" not in (ROOT / "Dockerfile").read_text()
    for line in (*project["dependencies"], *extras):
        needed = Requirement(line)
        assert needed.specifier.contains(packages[canonicalize_name(needed.name)]), line


def test_all_say_the_same_version() -> None:
    client = tomllib.loads((ROOT / "client" / "pyproject.toml").read_text())
    images = yaml.safe_load((ROOT / "deploy" / "kubernetes" / "kustomization.yaml").read_text())
    laboratory = tomllib.loads((ROOT / "laboratory" / "pyproject.toml").read_text())
    assert client["project"]["version"] == laboratory["project"]["version"] == __version__
    assert [one["newTag"] for one in images["images"]] == [__version__]
    assert f"\n## {__version__} (" in (ROOT / "CHANGELOG.md").read_text()
