"""A cell that takes assets up, or is offline, and what the tests of its routes send."""

from collections.abc import Mapping
from typing import Any

from service.store import AuditEntry

CONFIGURATION = {
    "sources": [
        {"name": "gateway-1", "driver": "modbus-tcp", "host": "127.0.0.1", "port": 5020},
    ],
    "templates": [
        {
            "name": "axle",
            "bearing": "6311",
            "low_risk": {"speed_rpm_max": 900, "load_n_max": 4000},
            "values": {"gateway": "gateway-1"},
            "channels": {
                "t_outer_ring_c": {
                    "source": "{gateway}",
                    "unit_id": "{unit}",
                    "register": 0,
                    "kind": "input",
                },
                "ambient_c": {"source": "push"},
                "speed_rpm": {"source": "push"},
                "load_n": {"source": "push"},
            },
        }
    ],
    "assets": [{"id": "bench-1", "template": "axle", "values": {"unit": 1}}],
}
AXLE = {"template": "axle", "values": {"unit": 11}}
ASSETS = "/api/v1/assets"
IMPORT = "/api/v1/assets:import"
REMOVE = "/api/v1/assets:remove"
PROVISIONING = "/api/v1/provisioning"
ONLY_NEW = {"If-None-Match": "*"}
CSV = {"Content-Type": "text/csv; charset=utf-8"}


class Cell:
    """The boundary to the cell: counts how often it was to take up, or is away."""

    def __init__(self) -> None:
        self.asked = 0
        self.away: Exception | None = None
        self.wrong: Mapping[str, str] = {}

    async def apply(self) -> Mapping[str, str]:
        self.asked += 1
        if self.away is not None:
            raise self.away
        return self.wrong


def audit(world: Any) -> list[AuditEntry]:
    lines: list[AuditEntry] = world.store.audit.page(100).items
    return [line for line in lines if line.action.startswith("asset")]
