"""The permissive of a real service whose cell stands still, and is killed."""

import os
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from typing import Any

import pytest
from patience import patience
from processes import Command, Station, free_port, wait_until
from pymodbus.client import ModbusTcpClient
from pymodbus.exceptions import ModbusException
from site_files import MACHINE, OBSERVE, asset_text, write_site

from service.bus.replica import UNCERTAIN_AFTER_S
from service.clock import wall_us
from service.jobs.models import first_model
from service.site.settings import load_settings
from service.store import FirstModel

pytestmark = [pytest.mark.wires, pytest.mark.timeout(900), pytest.mark.endurance]

PATIENCE_S = 120.0
#: At rest in its surroundings: nothing to exceed a limit far above.
VALUES = {"speed_rpm": 500.0, "load_n": 1000.0, "ambient_c": 22.0, "t_inner_ring_c": 25.0}
MODBUS = "[modbus_server]\nenabled = true\nport = {port}\n"
LIMITS = "limits = { t_inner_ring_c = { warning = 300, alarm = 350 } }"


class Plc:
    """Reads bit, word, heartbeat and status with one connection."""

    def __init__(self, port: int) -> None:
        self.port = port
        self.client = ModbusTcpClient("127.0.0.1", port=port, timeout=patience(5))

    def head(self) -> list[int]:
        if not self.client.connect():
            return []
        answer = self.client.read_input_registers(0, count=12)
        return [] if answer.isError() else list(answer.registers)

    def answer(self) -> list[bool] | None:
        """The first bit that comes, in a list."""
        may_begin = self.may_begin()
        return None if may_begin is None else [may_begin]

    def may_begin(self) -> bool | None:
        head = self.head()
        bit = self.client.read_discrete_inputs(0, count=1)
        if not head or bit.isError():
            return None
        return bool(bit.bits[0]) and head[10] == 1


@pytest.fixture(scope="module")
def running(
    tmp_path_factory: pytest.TempPathFactory,
) -> Iterator[tuple[Command, Callable[[], None], Plc]]:
    """A service whose asset has an identified model, what ends its values, and a PLC."""
    folder, modbus_port = tmp_path_factory.mktemp("plc"), free_port()
    text = MODBUS.format(port=modbus_port) + asset_text("motor-1", MACHINE, LIMITS, OBSERVE)
    with Station(folder, *write_site(folder, text)) as station:
        with station.open_store() as store:
            document: Any = first_model(load_settings(station.configuration).assets[0])
            trained = document["posterior"]["trained"] | {"minutes": 60}
            document |= {"posterior": document["posterior"] | {"trained": trained}}
            store.models.begin({"motor-1": FirstModel(document, "for the test")}, "test", wall_us())
        service, plc = station.start_service(), Plc(modbus_port)
        with station.pushing("motor-1", lambda: VALUES) as end, closing(plc.client):
            yield service, end, plc


def test_the_permissive_falls_with_the_cell_and_with_the_values(
    running: tuple[Command, Callable[[], None], Plc],
) -> None:
    service, end_of_values, plc = running
    wait_until(lambda: plc.may_begin(), PATIENCE_S, "the permissive is there")
    assert plc.head()[2] == 0
    with service.frozen("cell"):
        wait_until(lambda: plc.may_begin() is False, PATIENCE_S, "a frozen cell takes it")
        before = plc.head()
        assert before[2] == 2 + 4, "old, and not trusted"
        wait_until(lambda: plc.head()[0] != before[0], PATIENCE_S, "the plant side lives")
        assert not any(plc.may_begin() for _ in range(20))
    wait_until(lambda: plc.may_begin(), PATIENCE_S, "it comes back by itself")

    os.kill(service.side("cell"), signal.SIGKILL)
    wait_until(lambda: plc.may_begin() is False, PATIENCE_S, "a killed cell takes it")
    wait_until(lambda: plc.may_begin(), PATIENCE_S, "the next cell gives it back")

    # The plant side itself stands still: who asks gets no answer, and what it gets when the plant
    # side goes on is of that moment: the cell's old values give no permissive.
    plant = service.side("plant")
    with service.frozen("cell", "plant"):
        silent = ModbusTcpClient("127.0.0.1", port=plc.port, timeout=patience(1), retries=0)
        with pytest.raises(ModbusException), silent:
            silent.read_coils(0)
        time.sleep(UNCERTAIN_AFTER_S + 1.0)
        os.kill(plant, signal.SIGCONT)
        assert wait_until(plc.answer, PATIENCE_S, "an answer") == [False]
    wait_until(lambda: plc.may_begin(), PATIENCE_S, "it comes back")

    end_of_values()
    wait_until(lambda: plc.may_begin() is False, PATIENCE_S, "values that end take it")
