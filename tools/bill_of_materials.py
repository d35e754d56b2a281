"""Writes the bill of materials of a release: ``python -m tools.bill_of_materials``.

`bearing-twin.cdx.json` (CycloneDX 1.6) lists what the wheel contains that is not ours, and what the
image installs, from `requirements.lock`. It has no time and no random number: the same lock gives
the same bytes. `docs/run/licences.md` is the same as a table.
"""

import json
import re
from dataclasses import dataclass
from importlib.metadata import metadata
from pathlib import Path

from service import __version__

ROOT = Path(__file__).resolve().parents[1]
LOCK = ROOT / "requirements.lock"
BILL = ROOT / "bearing-twin.cdx.json"
PAGE = ROOT / "docs" / "run" / "licences.md"
#: SPDX identifiers of classifiers that say which licence it is ("BSD License" does not).
_CLASSIFIED = {
    f"License :: OSI Approved :: {name}": identifier
    for name, identifier in {
        "Apache Software License": "Apache-2.0",
        "GNU Lesser General Public License v3 or later (LGPLv3+)": "LGPL-3.0-or-later",
        "ISC License (ISCL)": "ISC",
        "MIT License": "MIT",
        "Python Software Foundation License": "PSF-2.0",
    }.items()
}
#: Read in the text of the licence, where the package says no more than "BSD".
_READ = {
    "aiomqtt": "BSD-3-Clause",
    "contourpy": "BSD-3-Clause",
    "cycler": "BSD-3-Clause",
    "jinja2": "BSD-3-Clause",
    "kiwisolver": "BSD-3-Clause",
    "locket": "BSD-2-Clause",
    "numba": "BSD-2-Clause",
    "partd": "BSD-3-Clause",
    "pyserial": "BSD-3-Clause",
    "scipy": "BSD-3-Clause",
    "wrapt": "BSD-2-Clause",
    "zict": "BSD-3-Clause",
}
_PRECISE = re.compile(r"\A(?:Apache-2\.0|BSD-[23]-Clause|MIT)\Z")
_PAGE = """\
# Licences

Here you find what a release contains and installs that is not ours, with its licence.

The product is under Apache-2.0. `make lock` writes these tables and the bill of materials
`bearing-twin.cdx.json` (CycloneDX 1.6), which every wheel carries in its folder `.dist-info/sboms`.
The base of the image is Debian: its packages have their licences in `/usr/share/doc/*/copyright`
inside the image, and `dpkg-query --list` there lists them.

## In the wheel

| part | version | licence | where |
| --- | --- | --- | --- |
{shipped}

## Installed with it

What [the image](containers.md) installs, from `requirements.lock`. Each package brings its licence.

| package | version | licence |
| --- | --- | --- |
{installed}
"""


@dataclass(frozen=True)
class Shipped:
    """A foreign part inside the wheel."""

    name: str
    version: str
    licence: str
    url: str
    path: str

    @property
    def ref(self) -> str:
        """Its name in the bill."""
        return f"shipped:{self.name}"

    def component(self) -> dict[str, object]:
        """The part in CycloneDX."""
        described: dict[str, object] = {
            "type": "library",
            "bom-ref": self.ref,
            "name": self.name,
            "licenses": [{"expression": self.licence}],
            "externalReferences": [{"type": "website", "url": self.url}],
            "properties": [{"name": "bearing-twin:path", "value": self.path}],
        }
        return described | ({"version": self.version} if self.version else {})


SHIPPED = (
    Shipped(
        "B612",
        "",
        "OFL-1.1",
        "https://github.com/polarsys/b612",
        "service/web/pages/static/fonts/",
    ),
    Shipped(
        "FMI headers",
        "2.0 and 3.0",
        "BSD-2-Clause",
        "https://fmi-standard.org",
        "service/offline/fmu/headers/",
    ),
    Shipped(
        "Preact",
        "11.2.0",
        "MIT",
        "https://github.com/preactjs/preact",
        "service/web/pages/static/vendor/preact",
    ),
    Shipped(
        "Swagger UI",
        "5.35.0",
        "Apache-2.0",
        "https://github.com/swagger-api/swagger-ui",
        "service/web/api/static/swagger-ui/",
    ),
    Shipped(
        "uPlot",
        "1.6.32",
        "MIT",
        "https://github.com/leeoniya/uPlot",
        "service/web/pages/static/vendor/uPlot",
    ),
)


@dataclass(frozen=True)
class Locked:
    """A package of the lock: its version, and the packages that ask for it."""

    name: str
    version: str
    asked_by: tuple[str, ...]

    @property
    def ref(self) -> str:
        """Its address, and its name in the bill."""
        return f"pkg:pypi/{self.name}@{self.version}"

    @property
    def licence(self) -> str:
        """As SPDX expression, from the package's own metadata; refused where those are vague."""
        described = metadata(self.name).json
        named = [
            _READ.get(self.name, ""),
            described.get("license_expression", ""),
            next(iter(_PRECISE.findall(str(described.get("license", "")))), ""),
            *(_CLASSIFIED.get(one, "") for one in described.get("classifier", [])),
        ]
        licence = next((str(one) for one in named if one), "")
        if not licence:
            raise SystemExit(f"{self.name}: licence not clear; read its text and add it to _READ")
        return licence

    def component(self) -> dict[str, object]:
        """The package in CycloneDX."""
        return {
            "type": "library",
            "bom-ref": self.ref,
            "name": self.name,
            "version": self.version,
            "purl": self.ref,
            "licenses": [{"expression": self.licence}],
        }


def locked(text: str) -> list[Locked]:
    """The packages of a lock, as uv writes it."""
    packages = []
    for block in re.split(r"^(?=\S)", text, flags=re.MULTILINE):
        if found := re.match(r"([\w.-]+)==(\S+)", block):
            asked_by = re.findall(
                r"^ +# +(?:via )?([\w.-]+)(?: \(pyproject\.toml\))?$", block, re.M
            )
            packages.append(Locked(found[1], found[2], tuple(asked_by)))
    return packages


def bill(packages: list[Locked]) -> dict[str, object]:
    """The whole document."""
    product = f"pkg:pypi/bearing-twin@{__version__}"
    refs = {"bearing-twin": product} | {one.name: one.ref for one in packages}
    needs: dict[str, list[str]] = {ref: [] for ref in refs.values()}
    for one in packages:
        for name in one.asked_by:
            if name != "via":
                needs[refs[name]].append(one.ref)
    needs[product] += [one.ref for one in SHIPPED]
    return {
        "$schema": "http://cyclonedx.org/schema/bom-1.6.schema.json",
        "bomFormat": "CycloneDX",
        "specVersion": "1.6",
        "version": 1,
        "metadata": {
            "lifecycles": [{"phase": "pre-build"}],
            "component": {
                "type": "application",
                "bom-ref": product,
                "name": "bearing-twin",
                "version": __version__,
                "purl": product,
                "licenses": [{"expression": "Apache-2.0"}],
            },
        },
        "components": [
            *(one.component() for one in SHIPPED),
            *(one.component() for one in packages),
        ],
        "dependencies": [
            {"ref": ref, "dependsOn": sorted(asked)} for ref, asked in sorted(needs.items())
        ],
    }


def page(packages: list[Locked]) -> str:
    """The page of licences."""
    return _PAGE.format(
        shipped="\n".join(
            f"| [{one.name}]({one.url}) | {one.version or '-'} | {one.licence} | `{one.path}` |"
            for one in SHIPPED
        ),
        installed="\n".join(f"| {one.name} | {one.version} | {one.licence} |" for one in packages),
    )


def documents() -> dict[Path, str]:
    """What is written, by file."""
    packages = locked(LOCK.read_text())
    text = json.dumps(bill(packages), indent=2, ensure_ascii=False)
    return {BILL: f"{text}\n", PAGE: page(packages)}


if __name__ == "__main__":
    for file, content in documents().items():
        file.write_text(content)
