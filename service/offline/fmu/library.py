"""The shared library of an FMU, compiled from its sources with the C compiler of this machine."""

import platform
import shutil
import subprocess
from collections.abc import Mapping, Sequence
from importlib import resources
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

from service.offline.fmu.errors import FmuError

# One library serves any processor of the kind with the same bits: nothing of this processor's own
# and no arithmetic beyond the standard's. Symbols are bound inside: one process may load many FMUs.
_OPTIONS: Final = (
    "-std=c99", "-O2", "-ffp-contract=off", "-Wall", "-shared", "-fPIC",
    "-fvisibility=hidden", "-Wl,-Bsymbolic", "-static-libgcc", "-s",
)  # fmt: skip
_PATIENCE_S: Final = 300.0
_FIXED: Final = ("laws", "eigen", "network", "instance")


def fixed_sources(fmi: int) -> dict[str, bytes]:
    """Return the C files that are the same for every model, by name, and the standard's headers."""
    package = resources.files("service.offline.fmu")
    names = [f"{name}.{ending}" for name in _FIXED for ending in ("h", "c")]
    found = {name: (package / "sources" / name).read_bytes() for name in (*names, f"fmi{fmi}.c")}
    for entry in sorted((package / "headers").iterdir(), key=lambda entry: entry.name):
        if entry.name.startswith(f"fmi{fmi}"):
            found[entry.name] = entry.read_bytes()
    return found


def compile_library(sources: Mapping[str, bytes], options: Sequence[str] = _OPTIONS) -> bytes:
    """Compile C files, by name, into a shared library for Linux on x86-64.

    Raises `FmuError` if this machine is another one, there is no C compiler, or it fails.
    """
    system, machine = platform.system(), platform.machine()
    if (system, machine) != ("Linux", "x86_64"):
        raise FmuError(f"an FMU cannot be built on {system} {machine}; expected Linux x86_64")
    compiler = shutil.which("cc")
    if compiler is None:
        raise FmuError(
            "no C compiler: the program 'cc' is not found; expected one, such as that of Debian's "
            "package 'gcc' with 'libc6-dev'"
        )
    with TemporaryDirectory(prefix="bearing-twin-fmu-") as folder:
        for name, content in sources.items():
            Path(folder, name).write_bytes(content)
        files = sorted(name for name in sources if name.endswith(".c"))
        command = [compiler, *options, *files, "-o", "library.so", "-lm"]
        try:
            done = subprocess.run(
                command, cwd=folder, capture_output=True, text=True, timeout=_PATIENCE_S
            )
        except (OSError, subprocess.TimeoutExpired) as error:
            raise FmuError(f"{compiler}: cannot be run ({error})") from error
        if done.returncode:
            lines = done.stderr.strip().splitlines()
            reason = next((line for line in lines if "error" in line), "".join(lines[:1]))
            raise FmuError(f"{compiler}: ended with {done.returncode} ({reason})")
        return Path(folder, "library.so").read_bytes()
