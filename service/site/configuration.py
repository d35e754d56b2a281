"""What every part of the configuration shares: strict sections, TOML files, errors in words."""

import re
import stat
import tomllib
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from adapters import words
from service.domain.errors import BearingTwinError
from service.files import EncodingError, utf8_of

EDGE_KINDS = (
    "constant",
    "contact",
    "convective",
    "convective-reference",
    "film",
    "shaft-sink",
    "speed-power",
)
SOURCE_KINDS = ("linear", "palmgren", "two-part")
LOSS_KINDS = ("copper", "power", "speed")


_SECRET = re.compile(r"pass(?!ed)|pwd|secret|token|(database|nats)_url|^url$", re.IGNORECASE)


class SettingsError(BearingTwinError, ValueError):
    """A configuration that cannot be used."""

    def __init__(self, *lines: str) -> None:
        self.lines = tuple(" ".join(line.split()) for line in lines)
        super().__init__("\n".join(self.lines))


def describe(error: ValidationError, prefix: str = "") -> str:
    """Say in one line which key of a configuration is wrong, its value and what was expected."""
    first, *others = describe_all(error, prefix)
    return f"{first} (and {len(others)} more)" if others else first


def describe_all(error: ValidationError, prefix: str = "") -> list[str]:
    """Say which keys of a configuration are wrong, one line per error."""
    errors = error.errors()
    places = [one["loc"] for one in errors]

    def follows(one: ErrorDetails) -> bool:
        """Whether it is too short only because its parts are wrong, which are named."""
        depth = len(one["loc"])
        return one["type"] == "too_short" and any(
            len(place) > depth and place[:depth] == one["loc"] for place in places
        )

    return [line for one in errors if not follows(one) for line in _lines(one, prefix)]


def _lines(error: ErrorDetails, prefix: str) -> Iterator[str]:
    key, place = prefix, error["loc"]
    for before, part in zip(("", *place), place, strict=False):
        # A kind in the place of a key is how pydantic names which of several tables it checked.
        of_table = isinstance(before, int) or before == "source"
        if part == "[key]" or (of_table and part in (*EDGE_KINDS, *SOURCE_KINDS, *LOSS_KINDS)):
            continue
        key += f"[{part}]" if isinstance(part, int) else f".{words.shown_name(part)}"
    key = key.removeprefix(".")
    message = error["msg"].removeprefix("Value error, ")
    given = error.get("input")
    shown = "" if isinstance(given, dict | list | BaseModel) else f" = {words.shown(given)}"
    if _is_secret(place) or error["type"] in ("model_type", "model_attributes_type"):
        shown = ""  # or a text in the place of a table, such as a URL
    if error["type"] == "missing":
        shown, message = "", "missing; expected a value"
    if error["type"] == "extra_forbidden":
        # Without its value: a password whose key is misspelled is a password.
        shown, message = "", "unknown key"
    if error["type"] in ("union_tag_invalid", "union_tag_not_found"):
        context = error["ctx"]
        shown = f".kind = {context['tag']!r}" if "tag" in context else ".kind"
        kinds = context.get("expected_tags") or ", ".join(
            repr(kind)
            for kind in (
                SOURCE_KINDS if "source" in key else LOSS_KINDS if "losses" in key else EDGE_KINDS
            )
        )
        message = f"expected one of {kinds}"
    # A file that the configuration names has errors of its own, any number of them.
    cause = error.get("ctx", {}).get("error")
    for line in cause.lines if isinstance(cause, SettingsError) else [message]:
        yield f"{key}{shown}: {line}" if key else line


def _is_secret(place: Iterable[int | str]) -> bool:
    """Whether a key's value is not for any screen or log, or may hold what is not."""
    return any(_SECRET.search(str(part)) for part in place)


TomlTable = dict[str, Any]
"""A table of the configuration as it was read: its owner checks it."""


def read_toml(file: Path, text: str | None = None) -> TomlTable:
    """Read a TOML file, or the text that it would hold.

    Raises `SettingsError` if it cannot be read.
    """
    try:
        return tomllib.loads(utf8_of(file.read_bytes()) if text is None else text)
    except OSError as error:
        raise SettingsError(f"{file}: cannot be read ({error.strerror})") from error
    except EncodingError as error:
        raise SettingsError(f"{file}: {error}") from error
    except tomllib.TOMLDecodeError as error:
        raise SettingsError(f"{file}: not valid TOML ({error})") from error


def readable_secrets(file: Path | None) -> list[str]:
    """Warn in one line when every user of the machine can read the secrets of a configuration."""
    try:
        if file is None or not file.stat().st_mode & stat.S_IROTH:
            return []
        names = list(_secrets(read_toml(file)))
    except (OSError, SettingsError):  # who reads it says so
        return []
    if not names:
        return []
    return [
        f"every user of this machine can read {', '.join(names)}; expected mode 0640 or 0600 "
        "of the file, or the value in the environment"
    ]


def _secrets(part: Any, key: str = "") -> Iterator[str]:
    """Name the keys of texts that only the service should know."""
    if isinstance(part, dict):
        for name, value in part.items():
            yield from _secrets(value, f"{key}.{name}" if key else name)
    elif isinstance(part, list):
        for number, value in enumerate(part):
            yield from _secrets(value, f"{key}[{number}]")
    elif isinstance(part, str) and part:
        name = key.rpartition(".")[2]
        is_address = name.lower() in ("database_url", "nats_url")
        is_secret = bool(_SECRET.search(name)) and not name.endswith(("_file", "_variable"))
        if is_secret and (not is_address or "@" in part.partition("://")[2]):
            yield key
