"""One script and one style sheet for the first view, made from the files below ``static``.

A browser can run those files as they are, but each of them costs it a request. The modules that
``js/app.js`` imports, directly or through others, become one module in its place: what is imported
comes first; the words ``import`` and ``export`` and the lines of comments are left out. Each module
exists once in the browser, so at the address of a packed one there is a stub that exports the same
names from ``js/app.js``. A module below ``vendor`` stays as it is, and the script imports it. The
sheets that ``css/first.css`` imports take the place of its ``@import`` lines.
"""

import posixpath
import re
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import NamedTuple

from service.domain.errors import BearingTwinError

_SCRIPT = "js/app.js"
_STYLE = "css/first.css"
_VENDOR = "vendor/"
_IMPORT = re.compile(r"^import (?:\{([\w\s,]*)\}\s+from )?'(\.[\w./]+)';\n", re.MULTILINE)
_COMMENT = re.compile(r"^ *(?://.*|/\*\*(?s:.*?)\*/)\n", re.MULTILINE)
_EXPORT = re.compile(r"^export ", re.MULTILINE)
#: A line at the top of a module that declares, imports or exports; its name where it declares one.
_TOP = re.compile(
    r"^(export )?(?:(?:async )?function\*?|class|const|let|var|import|export)\b"
    r"(?: (\w+)(?= =|;|\(| \{| extends ))?.*",
    re.MULTILINE,
)
_SHEET = re.compile(r'^@import "([\w./]+)"( print)?;\n', re.MULTILINE)


class PackingError(BearingTwinError, ValueError):
    """A file of the page is written in a way that cannot be packed."""


class _Module(NamedTuple):
    """A module without imports and comments, and the names at its top."""

    body: str
    declared: list[str]
    exported: list[str]


@cache
def packed_files(static: Path) -> Mapping[str, str]:
    """Pack the first view, once in a process.

    Returns text by path below the folder: the script, the style sheet, and a stub for each other
    module of the script. Raises `PackingError` if a name is declared twice at the top of the packed
    modules, or a line is not understood.
    """
    modules: dict[str, _Module] = {}
    _collect(static, _SCRIPT, modules, ())
    owners: dict[str, str] = {}
    for path, module in modules.items():
        for name in module.declared:
            if name in owners:
                raise PackingError(f"{path}: {name} is declared in {owners[name]} too, rename one")
            owners[name] = path
    stubs = {
        path: f"export {{ {', '.join(module.exported)} }} from '{_relative(_SCRIPT, path)}';\n"
        for path, module in modules.items()
        if not path.startswith(_VENDOR)
    }
    names = ", ".join(name for module in modules.values() for name in module.exported)
    script = "".join(module.body for module in modules.values()) + f"export {{ {names} }};\n"
    return stubs | {_SCRIPT: script, _STYLE: _packed_style(static)}


def _collect(static: Path, path: str, modules: dict[str, _Module], above: tuple[str, ...]) -> None:
    """Read a module after those that it imports."""
    if path in above:
        raise PackingError(f"{above[-1]}: import of {path}, expected no imports in a circle")
    text = (static / path).read_text(encoding="utf-8")
    for names, source in _IMPORT.findall(text):
        target = _target(path, source)
        if target.startswith(_VENDOR):
            if target in modules:
                raise PackingError(f"{path}: import of {target}, expected that of one module")
            modules[target] = _vendored(target, names)
            continue
        if target not in modules:
            _collect(static, target, modules, (*above, path))
        for name in filter(None, re.split(r"\s*,\s*", names.strip())):
            if name not in modules[target].exported:
                raise PackingError(f"{path}: import of {name!r}, expected an export of {target}")
    modules[path] = _module(path, _COMMENT.sub("", _IMPORT.sub("", text)))


def _vendored(path: str, names: str) -> _Module:
    """The import of a module that is not packed; here it may rename."""
    line = f"import {{{names}}} from '{_relative(path, _SCRIPT)}';\n"
    return _Module(line, re.findall(r"(\w+)\s*(?:,|$)", names), [])


def _module(path: str, text: str) -> _Module:
    declared, exported = [], []
    for line in _TOP.finditer(text):
        is_exported, name = line.groups()
        if not name:
            raise PackingError(
                f"{path}: {line[0]!r}, expected a declaration of one name or an import of names"
            )
        declared.append(name)
        if is_exported:
            exported.append(name)
    return _Module(f"// {path}\n{_EXPORT.sub('', text)}", declared, exported)


def _packed_style(static: Path) -> str:
    def sheet(found: re.Match[str]) -> str:
        path = _target(_STYLE, found[1])
        text = (static / path).read_text(encoding="utf-8")
        if posixpath.dirname(path) != posixpath.dirname(_STYLE) and "url(" in text:
            raise PackingError(f"{path}: url(), expected none outside the folder of {_STYLE}")
        return f"@media print {{\n{text}}}\n" if found[2] else f"{text}\n"

    style = _SHEET.sub(sheet, (static / _STYLE).read_text(encoding="utf-8"))
    left = re.search("^@import.*", style, re.MULTILINE)
    if left:
        raise PackingError(f'{_STYLE}: {left[0]!r}, expected a line such as @import "base.css";')
    return style


def _target(path: str, source: str) -> str:
    """Path of the file that a file refers to."""
    return posixpath.normpath(posixpath.join(posixpath.dirname(path), source))


def _relative(target: str, path: str) -> str:
    """Address of a file as another one writes it."""
    address = posixpath.relpath(target, posixpath.dirname(path))
    return address if address.startswith(".") else f"./{address}"
