"""Counts what shows whether this house is in order: ``python -m tools.house [--json]``.

The figures are those that the project has set itself bounds for. Each is counted from the files
that git keeps; what is generated or foreign is left out.
"""

import ast
import builtins
import json
import re
import subprocess
import sys
from collections import Counter, defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

ROOT = Path(__file__).resolve().parents[1]
#: Features, and the words by which their files are known.
FEATURES = {
    "notifications": ("notification", "notifications", "notifier", "letter", "telling", "tellings"),
    "silences": ("silence", "silences"),
    "runs": ("runs", "run_limits", "run_documents", "reports", "report"),
    "alarm_settings": ("alarm_settings", "alarm_sheets"),
    "commissioning": ("commissioning", "discovery"),
    "provisioning": ("provisioning", "asset_lists"),
    "ledger": ("ledger", "forecast_ledger", "forecast_performance", "forecast_scoring"),
    "nights": ("nights", "night", "fleet_identification"),
    "drift": ("drift",),
    "sisters": ("sisters", "population"),
    "advice": ("advice",),
}
#: Names that a package's root of errors, or the form of a feature's folder, asks for.
_NAMES_ASKED_FOR = frozenset({"errors", "health", "tables"})
#: Not the product's own lines: foreign, or made from other files.
_FOREIGN = ("service/web/pages/static/vendor/", "service/web/api/static/", "sources/fmi")
_GENERATED = ("client/bearing_twin_client/documents.py",)
_LABORATORY = ("laboratory/", "tools/")
_PRODUCT = ("service/", "twin_core/", "adapters/", "client/")
_CODE = (".py", ".js", ".css", ".c", ".h")
_STEP = re.compile(r"(Step|Stage|Point)$")
_BUILTINS = frozenset(dir(builtins))
#: Words of a private vocabulary and what the trade says instead.
WORDS = {
    "tell": r"tell(s|ing|ings)?|told|owed|letters?",
    "whoever, nobody": r"whoever|nobody",
    "by itself, take note, held against": r"by itself|takes? note|held against|taken in",
    "keeps house, settling, glance": r"keeps_house|settling|glance|carried_on",
    "hall": r"halls?",
    "anew, thereby, of late": r"anew|thereby|of late",
}


@dataclass(frozen=True)
class Module:
    """A Python file of the product and what it says."""

    path: PurePosixPath
    tree: ast.Module

    @property
    def package(self) -> str:
        """The package below the top that it stands in."""
        return "/".join(self.path.parts[:2]) if len(self.path.parts) > 2 else self.path.parts[0]

    def classes(self) -> Iterator[ast.ClassDef]:
        """All classes that it defines."""
        return (node for node in ast.walk(self.tree) if isinstance(node, ast.ClassDef))


def files() -> list[PurePosixPath]:
    """The files that git keeps, but for those that are not our own."""
    named = subprocess.run(
        ["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True
    )
    paths = (line for line in named.stdout.splitlines() if line not in _GENERATED)
    return [PurePosixPath(path) for path in paths if not any(part in path for part in _FOREIGN)]


def is_product(path: PurePosixPath) -> bool:
    """Whether a file belongs to what is shipped, the laboratory apart."""
    return str(path).startswith(_PRODUCT) and not str(path).startswith(_LABORATORY)


def lines_of(paths: list[PurePosixPath]) -> int:
    """All lines of these files, blank ones and comments included."""
    return sum(len((ROOT / path).read_bytes().splitlines()) for path in paths)


def files_outside(feature: str, modules: list[Module]) -> list[str]:
    """Files of a feature, by their name, that do not stand in its folder or that import it."""
    folder = ("service", "features", feature)
    outside = []
    for module in modules:
        if module.path.parts[:3] == folder or module.path.parts[0] != "service":
            continue
        is_named = bool({module.path.stem, *module.path.parts[1:-1]} & set(FEATURES[feature]))
        if is_named or _imports(module, ".".join(folder)):
            outside.append(str(module.path))
    return outside


def _imports(module: Module, package: str) -> bool:
    names: list[str] = []
    for node in ast.walk(module.tree):
        if isinstance(node, ast.ImportFrom):
            names.append(node.module or "")
        elif isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
    return any(f"{name}.".startswith(f"{package}.") for name in names)


def scattered_names(modules: list[Module]) -> list[str]:
    """Names of files that stand in more than three packages."""
    packages = defaultdict(set)
    for module in modules:
        stem = module.path.stem
        if not stem.startswith("__") and stem not in _NAMES_ASKED_FOR:
            packages[stem].add(module.package)
    return sorted(name for name, where in packages.items() if len(where) > 3)


def duplicated_classes(modules: list[Module]) -> list[str]:
    """Public class names that are defined twice or more."""
    counts = Counter(
        node.name for module in modules for node in module.classes() if node.name[0] != "_"
    )
    return sorted(name for name, count in counts.items() if count > 1)


def step_types(modules: list[Module]) -> list[str]:
    """Classes that each stand for a step, a stage or a point of operation."""
    found = {node.name for module in modules for node in module.classes()}
    return sorted(name for name in found if _STEP.search(name))


def errors_on_builtins(modules: list[Module]) -> list[str]:
    """Exception classes that derive from a builtin one without a root of the project."""
    own = []
    for module in modules:
        for node in module.classes():
            bases = [base.id for base in node.bases if isinstance(base, ast.Name)]
            is_error = any(base.endswith(("Error", "Exception")) for base in bases)
            if is_error and all(base in _BUILTINS for base in bases):
                own.append(node.name)
    return sorted(own)


def parameters_max(modules: list[Module]) -> tuple[int, str]:
    """The most parameters that a function of `twin_core` has, and its name."""
    most = (0, "")
    for module in modules:
        if module.path.parts[0] != "twin_core":
            continue
        for node in ast.walk(module.tree):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                of = node.args
                count = len(of.posonlyargs) + len(of.args) + len(of.kwonlyargs)
                most = max(most, (count, f"{module.path}:{node.name}"))
    return most


def words(paths: list[PurePosixPath]) -> dict[str, int]:
    """How often the private words stand in code, names included, in pages and docs."""
    text = "\n".join((ROOT / path).read_text(errors="replace") for path in paths)
    # Names are words too: told_us, NotToldError.
    text = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", text).replace("_", " ").lower()
    return {
        name: len(re.findall(rf"\b({pattern.replace('_', ' ')})\b", text))
        for name, pattern in WORDS.items()
    }


def figures() -> dict[str, object]:
    """All figures by name."""
    paths = files()
    product = [path for path in paths if is_product(path) and path.suffix in _CODE]
    tests = [path for path in paths if path.parts[0] == "tests" and path.suffix in _CODE]
    prose = [path for path in paths if path.suffix in (".md", ".html")]
    modules = [
        Module(path, ast.parse((ROOT / path).read_bytes()))
        for path in product
        if path.suffix == ".py"
    ]
    spoken = words([*product, *prose])
    most, where = parameters_max(modules)
    return {
        "files_outside_feature": {name: len(files_outside(name, modules)) for name in FEATURES},
        "names_in_more_than_three_packages": scattered_names(modules),
        "product_lines": lines_of(product),
        "page_lines": lines_of([path for path in product if path.suffix == ".js"]),
        "test_lines": lines_of(tests),
        "duplicated_class_names": duplicated_classes(modules),
        "step_types": step_types(modules),
        "errors_on_builtins": errors_on_builtins(modules),
        "words": {"all": sum(spoken.values()), **spoken},
        "parameters_max": most,
        "parameters_max_in": where,
    }


def table(found: dict[str, object]) -> str:
    """The figures as a table of Markdown."""
    rows = ["| figure | now |", "| --- | --- |"]
    for name, value in found.items():
        if isinstance(value, dict):
            shown = ", ".join(f"{key} {count}" for key, count in value.items())
        elif isinstance(value, list):
            shown = f"{len(value)}: {', '.join(value)}"
        else:
            shown = f"{value:,}" if isinstance(value, int) else str(value)
        rows.append(f"| {name} | {shown} |")
    return "\n".join(rows)


if __name__ == "__main__":
    measured = figures()
    sys.stdout.write(f"{json.dumps(measured) if '--json' in sys.argv[1:] else table(measured)}\n")
