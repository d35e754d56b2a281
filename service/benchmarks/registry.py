"""The benchmarks by name. A new one is a module with a function and a line here."""

from collections.abc import Callable, Sequence
from importlib import import_module

from service.benchmarks.common import BenchmarkError, Measurement, Progress

BENCHMARKS = {
    "simulate_14_node": "service.benchmarks.simulation:simulate_14_node",
    "simulate_vs_lsoda": "service.benchmarks.simulation:simulate_vs_lsoda",
    "identify_15_parameters": "service.benchmarks.identification:identify_15_parameters",
    "identify_default_model": "service.benchmarks.identification:identify_default_model",
    "forecast_ensemble": "service.benchmarks.forecasts:forecast_ensemble",
    "ingest_sqlite": "service.benchmarks.ingest:ingest_sqlite",
    "ingest_postgresql": "service.benchmarks.ingest:ingest_postgresql",
    "can_frames": "service.benchmarks.wires:can_frames",
    "modbus_reads": "service.benchmarks.wires:modbus_reads",
    "query_auto": "service.benchmarks.history:query_auto",
    "bytes_per_sample": "service.benchmarks.history:bytes_per_sample",
    "snapshot": "service.benchmarks.web:snapshot",
    "what_if_http": "service.benchmarks.web:what_if_http",
    "websocket_500": "service.benchmarks.web:websocket_500",
}
"""Where each one is: ``module:function``; imported only when it runs."""


def chosen(names: Sequence[str]) -> tuple[str, ...]:
    """The benchmarks of these names in the order given, or all.

    Raises
    ------
    BenchmarkError
        If one does not exist; names those that do.
    """
    for name in names:
        if name not in BENCHMARKS:
            raise BenchmarkError(f"benchmark {name!r}: expected one of {', '.join(BENCHMARKS)}")
    return tuple(dict.fromkeys(names)) or tuple(BENCHMARKS)


def run(name: str, tell: Progress) -> Measurement:
    """Run one benchmark."""
    module, _, function = BENCHMARKS[name].partition(":")
    benchmark: Callable[[Progress], Measurement] = getattr(import_module(module), function)
    return benchmark(tell)
