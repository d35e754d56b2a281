"""The benchmarks by name. A new one is a module with a function and a line here."""

from collections.abc import Callable, Sequence
from importlib import import_module

from bearing_twin_laboratory.benchmarks.common import BenchmarkError, Measurement, Progress

BENCHMARKS = {
    "simulate_14_node": "simulation:simulate_14_node",
    "simulate_vs_lsoda": "simulation:simulate_vs_lsoda",
    "identify_15_parameters": "identification:identify_15_parameters",
    "identify_default_model": "identification:identify_default_model",
    "identify_fleet": "fleet_identification:identify_fleet_warm",
    "forecast_ensemble": "forecasts:forecast_ensemble",
    "ingest_sqlite": "ingest:ingest_sqlite",
    "ingest_postgresql": "ingest:ingest_postgresql",
    "can_frames": "wires:can_frames",
    "modbus_reads": "wires:modbus_reads",
    "query_auto": "history:query_auto",
    "chart_30_days": "history:chart_30_days",
    "bytes_per_sample": "history:bytes_per_sample",
    "bytes_per_slow_sample": "history:bytes_per_slow_sample",
    "bytes_per_sample_postgresql": "history:bytes_per_sample_postgresql",
    "bytes_per_slow_sample_postgresql": "history:bytes_per_slow_sample_postgresql",
    "rollups": "rollups:rollups",
    "rollups_postgresql": "rollups:rollups_postgresql",
    "fleet_store": "fleet_store:fleet_store",
    "fleet_store_16000": "fleet_store:fleet_store_16000",
    "snapshot": "web:snapshot",
    "what_if_http": "web:what_if_http",
    "websocket_500": "web:websocket_500",
    "pushes": "pushes:pushes",
    "attacks": "attacks:attacks",
    "handlers": "handlers:handlers",
    "twins_10000": "twins:twins_10000",
    "start": "start:start",
    "kill_to_first_poll": "start:kill_to_first_poll",
    "memory": "start:memory",
    "assets_cpu": "fleet:assets_cpu",
}
"""Where each one is, ``module:function`` of this package; imported only when it runs."""

GROUPS = {"fleet": ("assets_cpu",)}
"""Benchmarks that one name stands for."""

ON_REQUEST = ("fleet_store", "fleet_store_16000")
"""Those that take from a quarter of an hour to an hour; they run only when they are named."""


def chosen(names: Sequence[str]) -> tuple[str, ...]:
    """The benchmarks of these names, or groups of them, in the order given; without any, the usual.

    Raises `BenchmarkError` if one does not exist; names those that do.
    """
    wanted: list[str] = []
    for name in names:
        if name not in BENCHMARKS and name not in GROUPS:
            known = ", ".join((*BENCHMARKS, *GROUPS))
            raise BenchmarkError(f"benchmark {name!r}: expected one of {known}")
        wanted += GROUPS.get(name, (name,))
    usual = (name for name in BENCHMARKS if name not in ON_REQUEST)
    return tuple(dict.fromkeys(wanted)) or tuple(usual)


def run(name: str, progress: Progress) -> Measurement:
    """Run one benchmark."""
    module, _, function = BENCHMARKS[name].partition(":")
    home = import_module(f"{__package__}.{module}")
    benchmark: Callable[[Progress], Measurement] = getattr(home, function)
    return benchmark(progress)
