"""Draws the packages and their imports, from the code, into CONTRIBUTING.md.

``python tests/package_graph.py`` writes the picture; a test compares it.
"""

import tomllib
from itertools import pairwise
from pathlib import Path

import grimp

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "CONTRIBUTING.md"
BEGIN, END = "<!-- package graph: begin -->\n", "<!-- package graph: end -->"


def imports() -> set[tuple[str, str]]:
    """Which package imports which: those of the service, and the other two."""
    graph = grimp.build_graph("service", "twin_core", "adapters", cache_dir=None)
    packages = {
        name: short
        for name in graph.find_children("service")
        if (short := name.removeprefix("service.")) != "__main__"
    }
    packages |= {"twin_core": "twin_core", "adapters": "adapters"}
    for name in packages:
        if graph.find_children(name):
            graph.squash_module(name)
    return {
        (packages[importer], packages[imported])
        for importer in packages
        for imported in graph.find_modules_directly_imported_by(importer)
        if imported in packages and imported != importer
    }


def layers() -> list[list[str]]:
    """The layers of the import walls, top first, with the other two packages below."""
    walls = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    [inside] = [
        one["layers"]
        for one in walls["tool"]["importlinter"]["contracts"]
        if one.get("containers") == ["service"]
    ]
    found = [[name.strip(" ()") for name in layer.split("|")] for layer in inside]
    return [*found, ["adapters", "twin_core"]]


def needed(edges: set[tuple[str, str]]) -> set[tuple[str, str]]:
    """Leave out what follows from the others: an import of what an imported package imports."""

    def reaches(start: str, end: str, without: tuple[str, str]) -> bool:
        seen, waiting = set(), [start]
        while waiting:
            here = waiting.pop()
            for importer, imported in edges:
                if importer == here and (importer, imported) != without and imported not in seen:
                    if imported == end:
                        return True
                    seen.add(imported)
                    waiting.append(imported)
        return False

    return {edge for edge in edges if not reaches(*edge, without=edge)}


def mermaid() -> str:
    """The picture: packages by layer, an arrow from each to what it imports.

    What follows from other arrows is left out. A dotted arrow points upwards: a mistake.
    """
    ranks = {name: rank for rank, layer in enumerate(layers()) for name in layer}
    edges = imports()
    down = {edge for edge in edges if ranks[edge[0]] < ranks[edge[1]]}
    lines = ["```mermaid", "flowchart TB"]
    lines += [
        f"  {' & '.join(above)} ~~~ {' & '.join(below)}" for above, below in pairwise(layers())
    ]
    lines += [f"  {importer} --> {imported}" for importer, imported in sorted(needed(down))]
    lines += [f"  {importer} -.-> {imported}" for importer, imported in sorted(edges - down)]
    return "\n".join([*lines, "```", ""])


def with_picture(text: str) -> str:
    """Put the picture into the text of the page."""
    before, _, rest = text.partition(BEGIN)
    _, _, after = rest.partition(END)
    return before + BEGIN + mermaid() + END + after


if __name__ == "__main__":
    PAGE.write_text(with_picture(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
