"""An identified model as one file that other simulation programs run."""

import hashlib
import zipfile
from dataclasses import dataclass
from pathlib import Path

from service.files import replacing
from service.offline.fmu import tables
from service.offline.fmu.description import IDENTIFIER, build_description, description
from service.offline.fmu.library import compile_library, fixed_sources
from service.offline.fmu.variables import Variable, variables_of
from service.offline.model_file import IdentifiedModel

_PLATFORMS = {2: "linux64", 3: "x86_64-linux"}
# Equal models give equal bytes: the parts have the date that ZIP begins with.
_DATE = (1980, 1, 1, 0, 0, 0)
_LICENCES = "documentation/licenses/license.txt"


@dataclass(frozen=True, slots=True)
class Exported:
    """What an FMU holds.

    ``token``: digest of the model and of the sources; a library refuses a description of another
    one.
    """

    token: str
    variables: tuple[Variable, ...]

    def names(self, causality: str) -> list[str]:
        """Names of the variables of a kind, in order."""
        return [one.name for one in self.variables if one.causality == causality]


def export_model(identified: IdentifiedModel, fmi: int, path: Path) -> Exported:
    """Write a model as an FMU for co-simulation and model exchange.

    Its most probable parameters are the start values of the FMU's parameters. Raises `FmuError` if
    the model has parts that the FMU does not know, or the library cannot be built; `FileError` if
    the file cannot be written.
    """
    variables = variables_of(identified)
    sources = fixed_sources(fmi)
    sources["model.c"] = tables.numbers(identified, variables).encode()
    digest = hashlib.sha256(tables.header(identified, "").encode())
    for name in sorted(sources):
        digest.update(name.encode() + b"\0" + sources[name] + b"\0")
    token = f"{{{digest.hexdigest()}}}"
    sources["model.h"] = tables.header(identified, token).encode()
    files = sorted(name for name in sources if name.endswith(".c"))
    known_by = dict.fromkeys((identified.model.name, identified.model.machine))
    parts = {
        "modelDescription.xml": description(fmi, " ".join(known_by), token, variables, files),
        f"binaries/{_PLATFORMS[fmi]}/{IDENTIFIER}.so": compile_library(sources),
        _LICENCES: _licences(sources),
        **{f"sources/{name}": content for name, content in sources.items()},
    }
    if fmi == 3:
        parts["sources/buildDescription.xml"] = build_description(files)
    with replacing(path, binary=True) as file, zipfile.ZipFile(file, "w") as archive:
        for part, content in parts.items():
            entry = zipfile.ZipInfo(part, _DATE)
            entry.compress_type = zipfile.ZIP_DEFLATED
            # Readable by all, and the library executable, wherever it is unpacked.
            entry.external_attr = (0o755 if part.endswith(".so") else 0o644) << 16
            archive.writestr(entry, content)
    return Exported(token, variables)


def _licences(sources: dict[str, bytes]) -> bytes:
    """The notice that the standard's headers ask to be kept with binaries, from one of them."""
    text = next(content for name, content in sources.items() if name.endswith("Functions.h"))
    notice = text[text.index(b"Copyright (C)") : text.index(b"*/")]
    return b"The headers fmi*.h in the folder sources:\n\n" + notice
