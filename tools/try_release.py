"""Installs a release as a user does and runs its demo: ``python -m tools.try_release``.

Wheel and source archive are built twice and must be the same bytes. The wheel is installed with
hashes into a fresh environment of this Python and of a newer one, where there is one, and
``bearing-twin demo`` runs in an empty folder, without this checkout.
"""

import json
import os
import shutil
import subprocess
import sys
import tarfile
import tempfile
import venv
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
NEWER = ("python3.14", "python3.13", "python3.12")
#: The demo's five hours in half a minute; what waits for an identification takes its own time.
DEMO = ("demo", "--headless", "--json", "--port", "0", "--rate", "600")


def say(text: str) -> None:
    """One line of progress."""
    sys.stderr.write(f"{text}\n")
    sys.stderr.flush()


def run(*command: str | Path, folder: Path) -> str:
    """Standard output of a command that must succeed; nothing points to this checkout."""
    environment = {
        name: value for name, value in os.environ.items() if not name.startswith("PYTHON")
    }
    ended = subprocess.run(
        command, cwd=folder, env=environment, stdout=subprocess.PIPE, text=True, check=False
    )
    if ended.returncode:
        raise SystemExit(f"{' '.join(map(str, command))} ended with {ended.returncode}")
    return ended.stdout


def build(sources: Path, target: str, out: Path) -> Path:
    """Build the wheel or the source archive of a folder."""
    hatchling = (sys.executable, "-m", "hatchling", "build")
    run(*hatchling, "--target", target, "--directory", out, folder=sources)
    (built,) = out.glob("*.whl" if target == "wheel" else "*.tar.gz")
    return built


def packages(work: Path) -> tuple[Path, Path]:
    """The source archive and the wheel; each is built twice and must be the same bytes."""
    archive = build(ROOT, "sdist", work / "first")
    with tarfile.open(archive) as opened:
        opened.extractall(work / "sources", filter="data")
    (sources,) = (work / "sources").iterdir()
    for file in sources.rglob("*"):
        os.utime(file, (0, 0))
    wheel = build(ROOT, "wheel", work / "first")
    for target, first in (("sdist", archive), ("wheel", wheel)):
        again = build(sources, target, work / "again")
        if again.read_bytes() != first.read_bytes():
            raise SystemExit(f"{first.name} is not the same when it is built from its sources")
        say(f"{first.name}: {first.stat().st_size} bytes, twice the same")
    return archive, wheel


def pythons() -> list[str]:
    """Give this Python, and the newest other one on the path that runs."""
    for name in NEWER:
        found = shutil.which(name)
        usable = found and subprocess.run([found, "-c", ""], capture_output=True, check=False)
        if found and usable and not usable.returncode and found != sys.executable:
            return [sys.executable, found]
    say(f"NOT TRIED: a newer Python; none of {', '.join(NEWER)} runs here")
    return [sys.executable]


def try_wheel(wheel: Path, python: str, work: Path) -> None:
    """Install it with hashes and run the demo."""
    work.mkdir()
    if python == sys.executable:
        venv.create(work / "venv", with_pip=True)
    else:
        run(python, "-m", "venv", work / "venv", folder=work)
    pip = work / "venv" / "bin" / "pip"
    install = (pip, "install", "--quiet", "--no-deps")
    run(*install, "--require-hashes", "--requirement", ROOT / "requirements.lock", folder=work)
    run(*install, wheel, folder=work)
    run(pip, "check", folder=work)
    command = work / "venv" / "bin" / "bearing-twin"
    version = run(command, "--version", folder=work).strip()
    document = json.loads(run(command, *DEMO, folder=work))
    stages = len(document["stages"])
    if not document["complete"] or not stages:
        raise SystemExit(f"{python}: the demo is not complete: {document}")
    say(f"{version}, {python}: demo complete, {stages} high-risk stages forecast")


def main() -> None:
    """Build and try, for each Python."""
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder)
        _, wheel = packages(work)
        for number, python in enumerate(pythons()):
            try_wheel(wheel, python, work / f"try-{number}")


if __name__ == "__main__":
    main()
