"""The benchmarks by name. A new one is a module with a function and a line here."""

from collections.abc import Callable, Sequence
from importlib import import_module

from service.lab.benchmarks.common import BenchmarkError, Measurement, Progress

BENCHMARKS = {
    "simulate_14_node": "service.lab.benchmarks.simulation:simulate_14_node",
    "simulate_vs_lsoda": "service.lab.benchmarks.simulation:simulate_vs_lsoda",
    "identify_15_parameters": "service.lab.benchmarks.identification:identify_15_parameters",
    "identify_default_model": "service.lab.benchmarks.identification:identify_default_model",
    "identify_fleet": "service.lab.benchmarks.fleet_identification:identify_fleet_warm",
    "forecast_ensemble": "service.lab.benchmarks.forecasts:forecast_ensemble",
    "ingest_sqlite": "service.lab.benchmarks.ingest:ingest_sqlite",
    "ingest_postgresql": "service.lab.benchmarks.ingest:ingest_postgresql",
    "can_frames": "service.lab.benchmarks.wires:can_frames",
    "modbus_reads": "service.lab.benchmarks.wires:modbus_reads",
    "query_auto": "service.lab.benchmarks.history:query_auto",
    "bytes_per_sample": "service.lab.benchmarks.history:bytes_per_sample",
    "snapshot": "service.lab.benchmarks.web:snapshot",
    "what_if_http": "service.lab.benchmarks.web:what_if_http",
    "websocket_500": "service.lab.benchmarks.web:websocket_500",
    "attacks": "service.lab.benchmarks.attacks:attacks",
    "twins_10000": "service.lab.benchmarks.twins:twins_10000",
    "assets_cpu": "service.lab.benchmarks.fleet:assets_cpu",
}
"""Where each one is: ``module:function``; imported only when it runs."""

GROUPS = {"fleet": ("assets_cpu",)}
"""Benchmarks that one name stands for."""


def chosen(names: Sequence[str]) -> tuple[str, ...]:
    """The benchmarks of these names, or groups of them, in the order given, or all.

    Raises
    ------
    BenchmarkError
        If one does not exist; names those that do.
    """
    wanted: list[str] = []
    for name in names:
        if name not in BENCHMARKS and name not in GROUPS:
            known = ", ".join((*BENCHMARKS, *GROUPS))
            raise BenchmarkError(f"benchmark {name!r}: expected one of {known}")
        wanted += GROUPS.get(name, (name,))
    return tuple(dict.fromkeys(wanted)) or tuple(BENCHMARKS)


def run(name: str, tell: Progress) -> Measurement:
    """Run one benchmark."""
    module, _, function = BENCHMARKS[name].partition(":")
    benchmark: Callable[[Progress], Measurement] = getattr(import_module(module), function)
    return benchmark(tell)
