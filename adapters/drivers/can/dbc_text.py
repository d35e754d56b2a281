"""What of a DBC file has to be left out before the library reads the rest.

It refuses a whole file for a message that cannot be, and for what is said of signals, messages and
attributes that are not there (a signal was removed by hand, its value table was not).
"""

import re
from collections import defaultdict
from collections.abc import Callable, Mapping
from typing import Final, NamedTuple

_MESSAGE: Final = re.compile(
    r"^BO_[ \t]+(\d+)[ \t]+([^\s:]+)[ \t]*:.*\n?((?:[ \t]*SG_[ \t].*\n?|[ \t]*\n)*)", re.MULTILINE
)
_SIGNAL: Final = re.compile(r"^[ \t]*SG_[ \t]+(\S+).*?:[ \t]*\d+\|(\d+)@", re.MULTILINE)
_TO_ITS_END: Final = r'(?:[^";]|"(?:\\.|[^"\\])*")*;[ \t]*\n?'
_OF_A_SIGNAL: Final = re.compile(
    rf"^(?:VAL_|SIG_VALTYPE_)[ \t]+(\d+)[ \t]+(\w+)\b{_TO_ITS_END}", re.MULTILINE
)
_ATTRIBUTE: Final = re.compile(rf'^BA_[ \t]+"([^"]*)"{_TO_ITS_END}', re.MULTILINE)
_ATTRIBUTE_NAMES: Final = re.compile(
    r'^BA_DEF_(?:[ \t]+(?:BU_|BO_|SG_|EV_))?[ \t]+"([^"]*)"', re.MULTILINE
)
_EXTENDED: Final = 1 << 31
_LAST_STANDARD: Final = 0x7FF


class ReadableText(NamedTuple):
    """The text that can be read, and why messages that are not in it cannot, by their names."""

    text: str
    flaws: Mapping[str, str]


def readable(text: str) -> ReadableText:
    """Leave out the messages that cannot be, and what is said of nothing in the file."""
    flaws: dict[str, str] = {}
    signals: defaultdict[str, set[str]] = defaultdict(set)

    def message(found: re.Match[str]) -> str:
        number, name, body = found.groups()
        lengths = dict(_SIGNAL.findall(body))
        without = [signal for signal, length in lengths.items() if not int(length)]
        if not int(number) & _EXTENDED and int(number) > _LAST_STANDARD:
            flaws[name] = f"its standard identifier {int(number):#x} has more than 11 bits"
        elif without:
            flaws[name] = f"signal {without[0]!r} has no length"
        else:
            signals[number] |= lengths.keys()
            return found[0]
        return ""

    text = _MESSAGE.sub(message, text)
    known = set(_ATTRIBUTE_NAMES.findall(text))
    text = _OF_A_SIGNAL.sub(_kept_if(lambda found: found[2] in signals[found[1]]), text)
    return ReadableText(_ATTRIBUTE.sub(_kept_if(lambda found: found[1] in known), text), flaws)


def _kept_if(is_known: Callable[[re.Match[str]], bool]) -> Callable[[re.Match[str]], str]:
    return lambda found: found[0] if is_known(found) else ""
