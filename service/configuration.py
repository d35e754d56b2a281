"""What every part of the configuration shares: strict sections, TOML files, errors in one line."""

import tomllib
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict, ValidationError

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


class SettingsError(ValueError):
    """A configuration that cannot be used; its text is one line for the user."""


class Section(BaseModel):
    """A table of the configuration: no unknown keys, finite numbers, unchangeable."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


def describe(error: ValidationError, prefix: str = "") -> str:
    """Say in one line which key of a configuration is wrong, its value and what was expected."""
    first = error.errors()[0]
    key = prefix
    for before, part in zip(("", *first["loc"]), first["loc"], strict=False):
        # A kind in the place of a key is how pydantic tells which of several tables it checked.
        of_table = isinstance(before, int) or before == "source"
        if part == "[key]" or (of_table and part in (*EDGE_KINDS, *SOURCE_KINDS)):
            continue
        key += f"[{part}]" if isinstance(part, int) else f"{'.' if key else ''}{part}"
    message = first["msg"].removeprefix("Value error, ")
    given = first.get("input")
    shown = "" if isinstance(given, dict | list | BaseModel) else f" = {given!r}"
    if first["type"] == "missing":
        shown, message = "", "missing; expected a value"
    if first["type"] == "extra_forbidden":
        message = "unknown key"
    if first["type"] in ("union_tag_invalid", "union_tag_not_found"):
        context = first["ctx"]
        shown = f".kind = {context['tag']!r}" if "tag" in context else ".kind"
        kinds = context.get("expected_tags") or ", ".join(
            repr(kind) for kind in (SOURCE_KINDS if "source" in key else EDGE_KINDS)
        )
        message = f"expected one of {kinds}"
    more = f" (and {error.error_count() - 1} more)" if error.error_count() > 1 else ""
    return f"{key}{shown}: {message}{more}" if key else f"{message}{more}"


def read_toml(file: Path) -> dict[str, Any]:
    """Read a TOML file.

    Raises
    ------
    SettingsError
        If it cannot be read.
    """
    try:
        return tomllib.loads(file.read_text(encoding="utf-8"))
    except OSError as error:
        raise SettingsError(f"{file}: cannot be read ({error.strerror})") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise SettingsError(f"{file}: not valid TOML ({error})") from error
