"""A machine at work, and a twin that follows it."""

from typing import Any

WARM = {
    "speed_rpm": 2400.0,
    "load_n": 2650.0,
    "ambient_c": 23.0,
    "t_inner_ring_c": 55.0,
    "t_outer_ring_c": 38.0,
}


async def running(live: Any, values: dict[str, float]) -> None:
    live.start()
    await live.until(lambda: live.runtime.estimate.started, "a start", values)
