"""Raw values of a signal that are codes and no measurements."""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from cantools.database.can import Message, Signal

SHORTEST_FLAGGED_BITS = 8  # all ones in a shorter field is an ordinary value outside J1939
LARGEST_VALID_J1939_BYTE = 0xFA  # top byte: FB to FD special, FE error, FF not available
# NMEA 2000, which signs values in J1939 frames: the three largest are reserved, error and
# not available.
SIGNED_J1939_CODES = 3

_WORDS = re.compile(r"(?<=[a-z])(?=[A-Z])|[\W_]+")
_NO_VALUE = re.compile(
    r"\b(sna|snv|n ?a|nan|inval\w*|unavail\w*|undef\w*|unknown|missing|disconnected|reserved|"
    r"init\w*|(over|under)(flow|range|run)|out of range|"
    r"not? (avail\w*|valid|known|defined|supported|connected|present|used|init\w*|data|value|"
    r"signal|sensor|info\w*)|"
    r"nicht (verf(ue|ü)gbar|g(ue|ü)ltig)|ung(ue|ü)ltig)\b"
)
_FAILURE = re.compile(
    r"(?<!\bno )\b(err|errors?|fault\w*|fail\w*|defect\w*|broken|malfunction|implausible|"
    r"(open|short) (circuit|load|wire)|(wire|line|cable) break|fehler\w*|defekt)\b(?! free)"
)


@dataclass(frozen=True, slots=True)
class NoValue:
    """Which raw values mean "no value", and what to call them.

    - ``named``: single values.
    - ``reserved_from``: this and all above, but for ``ordinary`` ones; infinite when none.
    - ``blank``: all ones in a frame of nothing but ones, which is an ordinary value elsewhere.
    """

    named: Mapping[float, str] = field(default_factory=dict)
    reserved_from: float = math.inf
    ordinary: frozenset[float] = frozenset()
    blank: float = math.nan

    def meaning(self, raw: float, is_blank: bool) -> str:
        """Say why a raw value is none; empty for a measurement."""
        name = self.named.get(raw)
        if name is not None:
            return name
        if raw >= self.reserved_from and raw not in self.ordinary:
            return "J1939: error or not available"
        if is_blank and raw == self.blank:
            return "all bits of the frame are ones"
        return ""


def no_value(message: Message, signal: Signal, sentinels: Sequence[float]) -> NoValue:
    """Find what means "no value": by the channel, by the file's value table, by its kind.

    What the value table names is what it says there, also where the kind has a code.
    """
    labels = _labels(signal)
    named = dict(_by_kind(message, signal))
    reserved_from = _reserved_from(message, signal)
    for raw, label in labels.items():
        named.pop(raw, None)
        fails = _says(_FAILURE, label)
        is_code = fails and (raw >= reserved_from or not _is_state(signal, labels, raw))
        if is_code or _says(_NO_VALUE, label):
            named[raw] = f'"{label}" in the DBC file'
    named |= {float(raw): "sentinel" for raw in sentinels}
    is_signed = signal.is_signed and not signal.is_float and signal.length >= SHORTEST_FLAGGED_BITS
    return NoValue(
        named,
        reserved_from,
        frozenset(labels) - frozenset(named),
        -1.0 if is_signed and -1 not in labels else math.nan,
    )


def _labels(signal: Signal) -> dict[float, str]:
    """The value table by the raw values that decoding gives."""
    labels: dict[float, str] = {}
    for raw, label in (signal.choices or {}).items():
        value = int(raw)
        if signal.is_signed and value >> (signal.length - 1) == 1:  # written as if unsigned
            value -= 1 << signal.length
        labels[value] = str(label)
    return labels


def _is_state(signal: Signal, labels: Mapping[float, str], raw: float) -> bool:
    """Whether a value belongs to states that are counted: off 0, running 1, fault 2."""
    if signal.length < SHORTEST_FLAGGED_BITS:
        return True
    first = raw
    while first - 1 in labels:
        first -= 1
    counted: list[str] = []
    while first + len(counted) in labels:
        counted.append(labels[first + len(counted)])
    return first in {0, 1} and any(
        not _says(_NO_VALUE, label) and not _says(_FAILURE, label) for label in counted
    )


def _says(words: re.Pattern[str], label: str) -> bool:
    return words.search(_WORDS.sub(" ", label).lower()) is not None


def _by_kind(message: Message, signal: Signal) -> dict[float, str]:
    """The codes of a whole number: all ones, and the ends of the range of a signed one."""
    bits = signal.length
    if signal.is_float or bits < SHORTEST_FLAGGED_BITS:
        return {}
    if not signal.is_signed:
        return {float((1 << bits) - 1): "all ones"}
    largest = (1 << (bits - 1)) - 1
    codes: dict[float, str] = {largest: "largest raw value", -largest - 1: "least raw value"}
    if message.protocol == "j1939":
        codes |= {largest - n: "NMEA 2000 code" for n in range(SIGNED_J1939_CODES)}
        codes[-1] = "all ones"
    return codes


def _reserved_from(message: Message, signal: Signal) -> float:
    """Lowest unsigned raw value that J1939-71 reserves, by the length of the signal."""
    bits = signal.length
    if message.protocol != "j1939" or signal.is_float or signal.is_signed or bits < 2:
        return math.inf
    if bits >= 8 and bits % 4 == 0:
        return (LARGEST_VALID_J1939_BYTE + 1) << (bits - 8)
    return (1 << bits) - 2  # error and not available
