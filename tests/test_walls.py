"""twin_core imports numpy, scipy, numba and a few pure modules of the standard library, no more.

import-linter forbids what we know of; this test also catches what nobody thought of.
"""

import ast
from pathlib import Path

import pytest

import twin_core

ROOT = Path(twin_core.__file__).parent
# llvmlite is what numba generates code with: a few vector operations are written in its terms.
ALLOWED = {"numpy", "scipy", "numba", "llvmlite", "twin_core"}
# Pure computation, types, and the thread pool around kernels without the interpreter's lock.
PURE = {
    "collections",
    "concurrent",
    "contextlib",
    "dataclasses",
    "enum",
    "functools",
    "hashlib",
    "itertools",
    "math",
    "operator",
    "statistics",
    "typing",
    "warnings",
}


@pytest.mark.parametrize("file", sorted(ROOT.rglob("*.py")), ids=lambda file: file.name)
def test_only_allowed_imports(file: Path) -> None:
    modules = set()
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.Import):
            modules |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "relative import"
            modules.add(node.module or "")
    assert {module.partition(".")[0] for module in modules} <= ALLOWED | PURE
