"""Units that sources and files state, turned into those of our channels."""

import math
import re
import unicodedata
from typing import Final, Protocol

from adapters.words import shown

# By our unit: the names that others give it or another unit, with scale and offset into ours.
# "Â°C" is what readers make of a UTF-8 file that they take for a Western European one.
_NAMES: Final = {
    "°C": {
        (
            *("°C", "C", "Cel", "Celsius", "Â°C", "degC", "degCelsius", "degreeC", "degreesC"),
            *("degreeCelsius", "degreesCelsius", "GradC", "GradCelsius"),
        ): (1.0, 0.0),
        ("K", "°K", "degK", "Kelvin"): (1.0, -273.15),
        (
            *("°F", "F", "Fahrenheit", "Â°F", "degF", "degFahrenheit", "degreeF", "degreesF"),
            *("degreeFahrenheit", "degreesFahrenheit"),
        ): (5.0 / 9.0, -160.0 / 9.0),
    },
    # Not "Hz": a drive's is that of its current.
    "rpm": {
        ("rpm", "1/min", "min-1", "min^-1", "/min", "r/min", "rev/min", "U/min", "tr/min"): (1, 0),
        ("1/s", "s-1", "s^-1", "rps", "r/s", "rev/s"): (60.0, 0.0),
        ("rad/s",): (30.0 / math.pi, 0.0),
    },
    "N": {
        ("N", "Newton", "Newtons"): (1.0, 0.0),
        ("daN",): (10.0, 0.0),
        ("kN", "Kilonewton"): (1e3, 0.0),
        ("lbf",): (4.4482216152605, 0.0),
    },
}
# What says that "(K)" behind it may be a type: NiCr-Ni is type K.
_THERMOCOUPLE: Final = re.compile(
    r"thermoco|thermoel|nicr|(?<![a-z])(?:(?-i:T/?C|t/?c)|type?[ -]?k|k-?type?)(?![a-z])",
    re.IGNORECASE,
)
_IN_BRACKETS = re.compile(r"[\[(]([^\[\]()]*)[\])]\s*$")


def _plain(unit: str) -> str:
    """Leave out what people write differently: spaces, dots, capitals, raised figures."""
    # An ordinal sign for a degree, and a degree sign of DOS that was read as one of Windows.
    text = unicodedata.normalize("NFKC", unit.replace("º", "°").replace("ø", "°"))
    return re.sub(r"[\s_.]", "", text.replace("\N{MINUS SIGN}", "-")).casefold()


_KNOWN: Final = {
    ours: {_plain(name): factors for names, factors in groups.items() for name in names}
    for ours, groups in _NAMES.items()
}


def into_unit(ours: str, theirs: str) -> tuple[float, float] | None:
    """Give the scale and the offset that turn values in their unit into ours.

    ``theirs``: as a source or a file has it; empty counts as ours. None where it is none that goes
    into ours. Of what we have no other units for, all counts as ours.
    """
    if not theirs.strip() or ours not in _KNOWN:
        return 1.0, 0.0
    return _KNOWN[ours].get(_plain(theirs))


#: What a channel needs where `kelvin_doubt` says something.
KELVIN_OR_NOT: Final = "scale = 1 for °C, or offset = -273.15 for kelvin"


class UnitError(ValueError):
    """A unit that does not go into that of the channel; says which one, and what was expected."""


class Scaled(Protocol):
    """What is configured of a channel: its value is what was read times scale plus offset."""

    @property
    def scale(self) -> float:
        """Factor into the channel's unit."""

    @property
    def offset(self) -> float:
        """Added after that."""

    @property
    def model_fields_set(self) -> set[str]:
        """Keys that are given."""


def is_scaled(config: Scaled) -> bool:
    """Whether a scale or an offset is configured: the unit that a source states is ignored then."""
    return bool({"scale", "offset"} & config.model_fields_set)


def needs_unit(config: Scaled, ours: str) -> bool:
    """Whether values depend on the unit that a source states."""
    return ours in _KNOWN and not is_scaled(config)


def factors_of(config: Scaled, ours: str, theirs: str) -> tuple[float, float]:
    """Scale and offset as configured, else those of the stated unit.

    Raises `UnitError` for a unit that does not go into ours.
    """
    if is_scaled(config):
        return config.scale, config.offset
    found = into_unit(ours, theirs)
    if found is None:
        raise UnitError(f"in {shown(theirs)}; expected {', '.join(units_for(ours))}")
    return found


def conversion(config: Scaled, ours: str, theirs: str) -> str:
    """What `factors_of` does to values, for a report: ``'kN' × 1000 -> N``; empty where nothing.

    A configured scale says so, also one of 1 where the stated unit would have another.
    """
    factors = factors_of(config, ours, theirs)
    if factors == (1.0, 0.0) and into_unit(ours, theirs) == factors:
        return ""
    scale, offset = factors
    steps = [shown(theirs) if theirs.strip() else "value"]
    if scale != 1.0 or not offset:
        steps.append(f"× {scale:.10g}")
    if offset:
        steps.append(f"{'-' if offset < 0.0 else '+'} {abs(offset):.10g}")
    if ours:
        steps.append(f"-> {ours}")
    if is_scaled(config):
        steps.append("(scale and offset of the mapping)")
    return " ".join(steps)


def units_for(ours: str) -> tuple[str, ...]:
    """Units that `into_unit` turns into ours, ours first."""
    return tuple(names[0] for names in _NAMES.get(ours, {}))


def unit_in(heading: str, ours: str) -> str:
    """Unit at the end of a column's name, in brackets: ``Load [kN]``; empty where there is none.

    What stands in round brackets is one only where `into_unit` knows it, and a number never is;
    ``(F)`` is front.
    """
    found = _IN_BRACKETS.search(heading)
    text = found[1].strip() if found else ""
    if not re.search(r"[^\W\d]|[°%]", text):
        return ""
    if heading.rstrip().endswith(")") and not re.search("[°%]", text):
        return "" if text == "F" or into_unit(ours, text) is None else text
    return text


def kelvin_doubt(config: Scaled, ours: str, heading: str) -> str:
    """Say what ``(K)`` can be where the heading names a thermocouple: ``TC3 (K)``.

    Empty where a scale or an offset is configured, or the heading leaves no doubt: ``[K]`` is one
    of a unit.
    """
    is_lone = re.search(r"\(\s*k\s*\)\s*$", heading, re.IGNORECASE)
    if ours != "°C" or is_scaled(config) or not is_lone or not _THERMOCOUPLE.search(heading):
        return ""
    return "(K) is kelvin or the type of a thermocouple"
