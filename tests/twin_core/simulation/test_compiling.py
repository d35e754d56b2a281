"""Names of compiled functions change with everything that goes into their code."""

from collections.abc import Callable
from typing import Any, NamedTuple

import pytest

from twin_core.simulation.compiling import compiled

CALLER = "def caller(x):\n    return FACTOR * callee(x)\n"


def _name(callee: str, factor: float) -> str:
    """Compile two functions that exist nowhere but here; return the caller's cached name."""
    scope: dict[str, Any] = {"FACTOR": factor}
    exec(f"def callee(x):\n    return {callee}\n", scope)
    scope["callee"] = compiled(scope["callee"])
    exec(CALLER, scope)
    function: Callable[[float], float] = compiled(scope["caller"])
    assert function(2.0) == factor * eval(callee, {"x": 2.0})
    return str(scope["caller"].__qualname__)


def test_a_change_of_callee_or_constant_changes_the_name() -> None:
    name = _name("x + 1.0", 3.0)
    assert _name("x + 1.0", 3.0) == name
    assert _name("x + 2.0", 3.0) != name
    assert _name("x - 1.0", 3.0) != name
    assert _name("x + 1.0", 4.0) != name
    assert name.startswith("caller_")


def _name_with(name: str, fields: list[tuple[str, Any]]) -> str:
    """Compile a function of a named tuple that holds another one."""
    kind = NamedTuple(name, fields)  # type: ignore[misc]

    class _Outer(NamedTuple):
        inner: kind  # type: ignore[valid-type]

    def sum_of(outer: Any) -> Any:
        return outer.inner.x + outer.inner.y

    sum_of.__annotations__["outer"] = _Outer
    function = compiled(sum_of)
    assert function(_Outer(kind(*(float(place) for place, _ in enumerate(fields))))) > 0.0
    return str(sum_of.__qualname__)


@pytest.mark.parametrize(
    ("name", "fields"),
    [
        ("_Renamed", [("x", float), ("y", float)]),
        ("_Point", [("y", float), ("x", float)]),
        ("_Point", [("x", float), ("y", float), ("z", float)]),
    ],
)
def test_a_named_tuple_that_is_another_one_changes_the_name(name: str, fields: Any) -> None:
    """The cache names its class: a version that has it no more would fail to read it."""
    before = _name_with("_Point", [("x", float), ("y", float)])
    assert _name_with("_Point", [("x", float), ("y", float)]) == before
    assert _name_with(name, fields) != before
