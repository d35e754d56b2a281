"""What all sides of a service need: loaded once, and shared by their processes.

Nothing here may start a thread or load the compiled twin, which is the cell's.
"""

import gc

import service.plant.start
import service.web.start

__all__ = ["service"]

# The processes share these objects as long as nobody writes to them; a collection would.
gc.collect()
gc.freeze()
