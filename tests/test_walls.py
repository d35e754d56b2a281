"""twin_core imports numpy, scipy, numba and a few pure modules of the standard library, no more.

Its surrogates alone may use scikit-learn, an extra, and nothing else in twin_core leans on them.
import-linter forbids what we know of; this test also catches what nobody thought of.
"""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import twin_core

ROOT = Path(twin_core.__file__).parent
SURROGATES = ROOT / "surrogates"
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
    allowed = ALLOWED | PURE
    if file.is_relative_to(SURROGATES):
        allowed |= {"sklearn"}
    else:
        assert not any(module.startswith("twin_core.surrogates") for module in modules)
    assert {module.partition(".")[0] for module in modules} <= allowed


WITHOUT_SCIKIT_LEARN = """
import importlib, pathlib, sys
sys.modules["sklearn"] = None
root = pathlib.Path(sys.argv[1])
for file in sorted(root.rglob("*.py")):
    name = ".".join(file.relative_to(root.parent).with_suffix("").parts)
    if not name.startswith("twin_core.surrogates"):
        importlib.import_module(name.removesuffix(".__init__"))
assert not any(name.startswith("sklearn.") for name in sys.modules)
try:
    import twin_core.surrogates
except ImportError as error:
    print(error)
"""


def test_all_but_the_surrogates_can_do_without_scikit_learn() -> None:
    done = subprocess.run(
        [sys.executable, "-c", WITHOUT_SCIKIT_LEARN, str(ROOT)],
        capture_output=True,
        text=True,
        check=True,
        timeout=280,
    )
    expected = "scikit-learn is not installed: pip install 'bearing-twin[surrogates]'\n"
    assert done.stdout == expected
