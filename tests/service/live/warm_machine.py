"""A machine at work, and a twin that follows it."""

import asyncio
import json
from collections.abc import Callable
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


async def waiting(make_live: Callable[..., Any]) -> Any:
    """A twin that goes on from a kept estimate when it is ready for it, and is not yet."""
    before = make_live()
    await running(before, WARM)
    await before.stop()
    live = make_live()
    live.ready = asyncio.Event()
    live.start(json.loads(json.dumps(before.saved[-1])))
    await asyncio.sleep(0)
    return live
