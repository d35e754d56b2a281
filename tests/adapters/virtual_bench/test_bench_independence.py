import ast
from pathlib import Path

import adapters.virtual_bench

_PACKAGE = Path(adapters.virtual_bench.__file__).parent
_ALLOWED = {"cantools", "numba", "numpy", "pymodbus", "scipy"}


def _imported(source: Path) -> set[str]:
    names: set[str] = set()
    for node in ast.walk(ast.parse(source.read_text())):
        if isinstance(node, ast.Import):
            names.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{source.name}: relative import"
            names.add(node.module or "")
    return names


def test_bench_shares_no_code_with_twin_service_or_drivers() -> None:
    sources = sorted(_PACKAGE.rglob("*.py"))
    assert len(sources) > 10
    for source in sources:
        for name in _imported(source):
            top = name.split(".")[0]
            assert top not in {"twin_core", "service"}, f"{source.name} imports {name}"
            if top == "adapters":
                assert name.startswith("adapters.virtual_bench"), f"{source.name} imports {name}"


def test_bench_needs_only_declared_third_party_packages() -> None:
    import sys

    outside = {
        name.split(".")[0]
        for source in _PACKAGE.rglob("*.py")
        for name in _imported(source)
        if name.split(".")[0] not in sys.stdlib_module_names
    }
    assert outside - {"adapters"} == _ALLOWED
