from collections.abc import Iterator
from pathlib import Path

import pytest
from mqtt_site import Broker


@pytest.fixture
def broker(tmp_path: Path) -> Iterator[Broker]:
    broker = Broker(tmp_path)
    broker.start()
    yield broker
    broker.stop()
