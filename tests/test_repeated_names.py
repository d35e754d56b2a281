"""Names are compared in one walk: a loop that counts each name in all of them takes hours."""

import ast
from pathlib import Path

import adapters
import service
import twin_core

FOLDERS = [Path(package.__file__).parent for package in (adapters, service, twin_core)]
LOOPS = (ast.For, ast.ListComp, ast.SetComp, ast.GeneratorExp, ast.DictComp)


def names_in(part: ast.AST) -> set[str]:
    return {one.id for one in ast.walk(part) if isinstance(one, ast.Name)}


def names_of(loop: ast.AST) -> set[str]:
    targets = (
        [loop.target]
        if isinstance(loop, ast.For)
        else [part.target for part in getattr(loop, "generators", ())]
    )
    return {name for target in targets for name in names_in(target)}


def counted(tree: ast.AST) -> list[int]:
    """Lines of a loop that count what the loop runs over, or a part of it."""
    return [
        call.lineno
        for loop in ast.walk(tree)
        if isinstance(loop, LOOPS)
        for call in ast.walk(loop)
        if isinstance(call, ast.Call)
        and isinstance(call.func, ast.Attribute)
        and call.func.attr == "count"
        and len(call.args) == 1
        and any(
            isinstance(one, ast.Name) and one.id in names_of(loop) for one in ast.walk(call.args[0])
        )
    ]


def test_the_search_finds_what_it_looks_for() -> None:
    text = "for name in names:\n    if names.count(name) > 1: pass\n"
    assert counted(ast.parse(text)) == [2]
    assert counted(ast.parse("[n for n in names if names.count(n.id) > 1]")) == [1]


def test_no_loop_counts_each_name_in_all_of_them() -> None:
    found = [
        f"{file}:{line}"
        for folder in FOLDERS
        for file in folder.rglob("*.py")
        for line in counted(ast.parse(file.read_text(encoding="utf-8")))
    ]
    assert found == []
