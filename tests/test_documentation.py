"""The folder docs is a site: it is built strictly, and what is dead in it stops the build."""

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from patience import patience

ROOT = Path(__file__).parent.parent


def build(docs: Path, out: Path) -> subprocess.CompletedProcess[str]:
    """Build as `make docs` does; ``docs`` lies beside the other folders of a checkout."""
    options = ["--builder", "html", "--fail-on-warning", "--keep-going", "--quiet"]
    command = [sys.executable, "-m", "sphinx", *options, str(docs), str(out)]
    return subprocess.run(
        command, capture_output=True, text=True, timeout=patience(240), check=False
    )


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """A checkout whose pages may be changed; everything else in it is the real one."""
    for entry in ROOT.iterdir():
        if entry.name != "docs":
            (tmp_path / entry.name).symlink_to(entry)
    shutil.copytree(ROOT / "docs", tmp_path / "docs")
    return tmp_path


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("site")
    built = build(ROOT / "docs", out)
    assert built.returncode == 0, built.stderr
    return out


def test_every_page_is_built_and_found_by_the_search(site: Path) -> None:
    index = (site / "searchindex.js").read_text()
    pages = sorted((ROOT / "docs").rglob("*.md"))
    assert len(pages) > 20
    for page in pages:
        name = page.relative_to(ROOT / "docs").with_suffix("").as_posix()
        assert (site / f"{name}.html").is_file(), name
        assert f'"{name}"' in index, name


def test_the_site_loads_nothing_from_elsewhere(site: Path) -> None:
    for page in site.rglob("*.html"):
        text = page.read_text()
        loaded = re.findall(r'<(?:script|img|link)\b[^>]*(?:src|href)="(https?://[^"]+)"', text)
        assert not loaded, page.name


@pytest.mark.wires
def test_every_dead_link_is_reported_and_stops_the_build(checkout: Path, tmp_path: Path) -> None:
    dead = {
        "[gone](nowhere.md)": "nowhere.md",
        "[gone](alarms.md#no-such-heading)": "no-such-heading",
        "[gone](../../deploy/no-such-file.toml)": "no-such-file.toml",
        "![gone](../images/no-such-image.png)": "no-such-image.png",
    }
    page = checkout / "docs" / "operate" / "dashboard.md"
    page.write_text("\n\n".join([page.read_text(), *dead]))
    built = build(checkout / "docs", tmp_path / "site")
    assert built.returncode != 0
    complaints = built.stderr.strip().splitlines()
    assert len(complaints) == len(dead), built.stderr
    assert all(any(target in line for line in complaints) for target in dead.values())


@pytest.mark.wires
def test_a_page_outside_the_table_of_contents_stops_the_build(
    checkout: Path, tmp_path: Path
) -> None:
    (checkout / "docs" / "lost.md").write_text("# Lost\n")
    built = build(checkout / "docs", tmp_path / "site")
    assert built.returncode != 0
    assert "lost.md" in built.stderr


@pytest.mark.parametrize("page", ["README.md", "CONTRIBUTING.md", "CHANGELOG.md", "SECURITY.md"])
def test_pages_outside_the_site_have_no_dead_links(page: str) -> None:
    text = (ROOT / page).read_text()
    targets = re.findall(r"\]\(([^)#\s]+)(?:#[^)]*)?\)", text)
    local = [target for target in targets if "://" not in target]
    missing = [target for target in local if not (ROOT / target).exists()]
    assert not missing


def test_the_readme_is_short() -> None:
    assert len((ROOT / "README.md").read_text().splitlines()) <= 125


@pytest.mark.parametrize(
    "page",
    [page for page in sorted((ROOT / "docs").rglob("*.md")) if page.parent.name != "decisions"],
    ids=lambda page: page.name,
)
def test_every_page_opens_with_what_its_reader_can_do(page: Path) -> None:
    title, opening = page.read_text().split("\n\n")[:2]
    assert title.startswith("# ")
    assert re.match(r"(After (reading )?this page|Here) you ", opening)
