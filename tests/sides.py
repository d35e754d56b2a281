"""One side of a service in a process of its own: ``sides.py cell|web|plant CONFIGURATION PORT``."""

import asyncio
import sys
from pathlib import Path

from service.logs import configure_logging
from service.signals import stop_on_signals
from service.site.settings import Settings, load_settings


async def run(side: str, settings: Settings, port: int) -> None:
    stop = stop_on_signals()

    def ready() -> None:
        print("ready", flush=True)  # noqa: T201 - for the test

    if side == "cell":
        from service.cell.start import run_cell

        await run_cell(settings, stop=stop, ready=ready)
    elif side == "web":
        from service.web.listening import bind
        from service.web.start import run_web

        listener = bind("127.0.0.1", port)
        await run_web(settings, listener=listener, tls=None, stop=stop, ready=ready)
    else:
        from service.plant.start import run_plant

        await run_plant(settings, stop=stop, ready=ready)
    # What only the cell and the workers load.
    print("numba" if "numba" in sys.modules else "no numba", flush=True)  # noqa: T201


if __name__ == "__main__":
    configure_logging()
    asyncio.run(run(sys.argv[1], load_settings(Path(sys.argv[2])), int(sys.argv[3])))
