"""Names of compiled functions change with everything that goes into their code."""

from collections.abc import Callable
from typing import Any

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
