"""The permissive of a real service whose cell stands still, and is killed."""

import os
import signal
import threading
import time
from collections.abc import Iterator
from typing import Any

import httpx2
import pytest
from processes import Command, free_port, wait_until
from pymodbus.client import ModbusTcpClient
from pymodbus.exceptions import ModbusException

from service.bus.replica import UNCERTAIN_AFTER_S
from service.clock import rfc3339, wall_us
from service.jobs.models import first_model
from service.security.keys import create_key
from service.site.settings import load_settings
from service.store import FirstModel, Store

pytestmark = [pytest.mark.wires, pytest.mark.timeout(900)]

PATIENCE_S = 120.0
#: At rest in its surroundings: nothing to exceed a limit far above.
VALUES = {"speed_rpm": 500.0, "load_n": 1000.0, "ambient_c": 22.0, "t_inner_ring_c": 25.0}
CONFIGURATION = """
[service]
port = {port}
data_dir = "data"

[modbus_server]
enabled = true
port = {modbus_port}

[[assets]]
id = "motor-1"
bearing = "6311"
low_risk = {{ speed_rpm_max = 4300, load_n_max = 3400 }}
limits = {{ t_inner_ring_c = {{ warning = 300, alarm = 350 }} }}
identification = {{ ladder = "observe" }}
[assets.channels]
speed_rpm = {{ source = "push" }}
load_n = {{ source = "push" }}
ambient_c = {{ source = "push" }}
t_inner_ring_c = {{ source = "push" }}
"""


class Gateway(threading.Thread):
    """Pushes the machine's values twice a second."""

    def __init__(self, port: int, key: str) -> None:
        super().__init__()
        self.stop = threading.Event()
        self._url = f"http://127.0.0.1:{port}/api/v1/assets/motor-1/measurements"
        self._key = {"X-API-Key": key}

    def run(self) -> None:
        while not self.stop.wait(0.5):
            at = rfc3339(wall_us())
            samples = [{"channel": name, "time": at, "value": one} for name, one in VALUES.items()]
            try:
                httpx2.post(self._url, json={"samples": samples}, headers=self._key, timeout=2.0)
            except httpx2.TransportError:
                continue


class Plc:
    """Reads bit, word, heartbeat and status with one connection."""

    def __init__(self, port: int) -> None:
        self.port = port
        self.client = ModbusTcpClient("127.0.0.1", port=port, timeout=5)

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
def running(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """A service whose asset has an identified model, values that come, and a PLC."""
    folder = tmp_path_factory.mktemp("plc")
    port, modbus_port = free_port(), free_port()
    file = folder / "site.toml"
    file.write_text(CONFIGURATION.format(port=port, modbus_port=modbus_port))
    settings = load_settings(file)
    with Store.open("", settings.data_dir) as store:
        key = create_key(store, "gateway").text
        document: Any = first_model(settings.assets[0])
        trained = document["posterior"]["trained"] | {"minutes": 60}
        document |= {"posterior": document["posterior"] | {"trained": trained}}
        store.models.begin({"motor-1": FirstModel(document, "for the test")}, "test", wall_us())
    service = Command(["serve", "-c", str(file)], folder / "service.log")
    gateway = Gateway(port, key)
    gateway.start()
    plc = Plc(modbus_port)
    try:
        yield service, gateway, plc
    finally:
        gateway.stop.set()
        gateway.join()
        plc.client.close()
        service.end()


def test_the_permissive_falls_with_the_cell_and_with_the_values(running: Any) -> None:
    service, gateway, plc = running
    wait_until(lambda: plc.may_begin(), PATIENCE_S, "the permissive is there")
    assert plc.head()[2] == 0
    cell = service.side("cell")

    os.kill(cell, signal.SIGSTOP)
    try:
        wait_until(lambda: plc.may_begin() is False, PATIENCE_S, "a frozen cell takes it")
        before = plc.head()
        assert before[2] == 2 + 4, "old, and not trusted"
        wait_until(lambda: plc.head()[0] != before[0], PATIENCE_S, "the plant side lives")
        assert not any(plc.may_begin() for _ in range(20))
    finally:
        os.kill(cell, signal.SIGCONT)
    wait_until(lambda: plc.may_begin(), PATIENCE_S, "it comes back by itself")

    os.kill(cell, signal.SIGKILL)
    wait_until(lambda: plc.may_begin() is False, PATIENCE_S, "a killed cell takes it")
    wait_until(lambda: plc.may_begin(), PATIENCE_S, "the next cell gives it back")

    # The plant side itself stands still: who asks gets no answer, and what it gets when the plant
    # side goes on is of that moment: the cell's old values give no permissive.
    plant, cell = service.side("plant"), service.side("cell")
    os.kill(plant, signal.SIGSTOP)
    try:
        silent = ModbusTcpClient("127.0.0.1", port=plc.port, timeout=1, retries=0)
        with pytest.raises(ModbusException), silent:
            silent.read_coils(0)
        os.kill(cell, signal.SIGSTOP)
        time.sleep(UNCERTAIN_AFTER_S + 1.0)
        os.kill(plant, signal.SIGCONT)
        assert wait_until(plc.answer, PATIENCE_S, "an answer") == [False]
    finally:
        os.kill(plant, signal.SIGCONT)
        os.kill(cell, signal.SIGCONT)
    wait_until(lambda: plc.may_begin(), PATIENCE_S, "it comes back")

    gateway.stop.set()
    wait_until(lambda: plc.may_begin() is False, PATIENCE_S, "values that end take it")
