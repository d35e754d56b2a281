"""Mistakes in the units of a file, said before anything is computed from it."""

from service.offline.tables import PlannedRows, Recording, TableError
from service.site.machines.machine import Machine
from service.site.machines.plausibility import Doubt, doubts_of_rows


def doubts_of_recording(recording: Recording, machine: Machine) -> list[str]:
    """Say what of recorded rows may be in another unit, one line each.

    Raises `TableError` where no machine can be so.
    """
    columns = {
        "speed_rpm": recording.speed_rpm,
        "load_n": recording.load_n,
        "ambient_c": recording.ambient_c,
        **recording.temperatures_c,
    }
    return _said(recording.name, doubts_of_rows(machine.bearing, columns, recording.time_s))


def doubts_of_profile(name: str, rows: PlannedRows, machine: Machine) -> list[str]:
    """As `doubts_of_recording`, of a profile, whose steps may be as long as they like."""
    columns = {"speed_rpm": rows.speed_rpm, "load_n": rows.load_n, "ambient_c": rows.ambient_c}
    return _said(name, doubts_of_rows(machine.bearing, columns, rows.time_s[:0]))


def _said(name: str, doubts: list[Doubt]) -> list[str]:
    for doubt in doubts:
        if doubt.weight == "refused":
            raise TableError(f"{name}: {doubt.text}")
    return [f"{name}: {doubt.text}" for doubt in doubts]
