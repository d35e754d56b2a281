"""Reads a DBC file without that for which the library refuses it, though no channel may read it.

It refuses a whole file for a message that cannot be, and for what is said of signals and attributes
that are not there (a signal was removed by hand, its value table was not). Only what its refusal
names is left out: nothing else of the file gets another meaning.
"""

import re
from collections.abc import Mapping
from typing import Final

import cantools.database
from cantools.database.errors import UnsupportedDatabaseFormatError

from adapters.words import one_line

#: Each costs a reading of the file; one that names more is not worth it.
_REFUSALS_MAX: Final = 20
_IN_MESSAGE: Final = re.compile(r" in message (\S+)\.$")
_OF_A_SIGNAL: Final = re.compile(r"^\s*(VAL_|SIG_VALTYPE_) (\d+) (\S+)$", re.MULTILINE)
_TO_ITS_END: Final = r'(?:[^";]|"(?:\\.|[^"\\])*")*;'


def load(text: str) -> tuple[object, Mapping[str, str]]:
    """Read a DBC file; gives also why messages are left out, by their names.

    Raises `UnsupportedDatabaseFormatError` where the library still refuses it.
    """
    flaws: dict[str, str] = {}
    for _ in range(_REFUSALS_MAX):
        try:
            return _database(text), flaws
        except UnsupportedDatabaseFormatError as error:
            left = _without(text, error.e_dbc, flaws)
            if left == text:
                raise
            text = left
    return _database(text), flaws


def _database(text: str) -> object:
    return cantools.database.load_string(text, database_format="dbc", strict=False)


def _without(text: str, error: Exception | None, flaws: dict[str, str]) -> str:
    """Leave out what a refusal names, and note the message that it names."""
    said = str(error)
    if isinstance(error, KeyError):  # an attribute that is nowhere defined
        statement = rf'^BA_[ \t]+"{re.escape(str(error.args[0]))}"{_TO_ITS_END}'
        return re.sub(statement, "", text, flags=re.MULTILINE)
    if named := _IN_MESSAGE.search(said):
        name = named[1]
        block = rf"^BO_[ \t]+\d+[ \t]+{re.escape(name)}[ \t]*:.*\n?(?:[ \t]*(?:SG_[ \t].*)?\n)*"
        flaws[name] = one_line(error)[:200]
        return re.sub(block, "", text, flags=re.MULTILINE)
    for kind, number, signal in _OF_A_SIGNAL.findall(said):
        statement = rf"^{kind}[ \t]+{number}[ \t]+{re.escape(signal)}\b{_TO_ITS_END}"
        text = re.sub(statement, "", text, flags=re.MULTILINE)
    return text
