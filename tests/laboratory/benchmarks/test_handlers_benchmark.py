"""Whatever the cell is asked, it polls its devices in between."""

import pytest

from bearing_twin_laboratory.benchmarks.handlers import Asked, handlers
from bearing_twin_laboratory.benchmarks.handlers_site import largest_commands, site

pytestmark = [pytest.mark.laboratory, pytest.mark.wires]


async def test_every_command_of_the_cell_is_measured() -> None:
    async with site(30, alarming=30) as cell:
        asked, kinds = Asked(cell), set()
        try:
            for make in largest_commands(cell).values():
                command = make()
                kinds.add(type(command))
                assert 0.0 < await asked.step_s(command) < 1.0
        finally:
            await asked.close()
        assert kinds == set(cell.handlers), "a new command is measured, too"


@pytest.mark.timing
@pytest.mark.timeout(900)
def test_no_handler_of_the_cell_runs_longer_than_2_ms_at_a_thousand_assets() -> None:
    found = handlers(lambda fraction, text: None)
    assert found.unit == "s"
    assert found.value == max(found.extra["longest_step_s"].values())  # type: ignore[attr-defined]
    assert found.ratio is not None
    assert found.ratio < 1.0, (found.reference, found.extra["longest_step_s"])
