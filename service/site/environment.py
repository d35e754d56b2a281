"""The part of the configuration that comes from the environment, read as strictly as the file."""

import os
import re
from collections.abc import Iterable

from pydantic_settings import BaseSettings, EnvSettingsSource
from pydantic_settings import SettingsError as UnreadableVariableError

from adapters.configuration import suggestion

PREFIX = "BEARING_TWIN__"
_QUOTES = "'\""
_KEY = re.compile(r"[\w.]+(?:\[\d+\])*")


def environment_errors(settings: type[BaseSettings]) -> list[str]:
    """Say what is wrong with our variables, one line each; no values, since some are secret."""
    return [line for name in _names() if (line := _error(settings, name))]


def by_variable(lines: Iterable[str]) -> list[str]:
    """Name the variable in what is wrong with a key that comes from one."""
    keys = sorted(((key_of(name), name) for name in _names()), key=lambda one: -len(one[0]))
    found = []
    for line in lines:
        wrong = _KEY.match(line)
        named = "" if wrong is None else wrong[0]
        names = (
            name
            for key, name in keys
            if key == named
            or named.startswith((f"{key}.", f"{key}["))
            or key.startswith(f"{named}.")
        )
        name = next(names, "") if named else ""
        found.append(f"{name}: {line}" if name else line)
    return found


def is_variable(line: str) -> bool:
    """Whether a line of `by_variable` names one."""
    return line.upper().startswith(PREFIX)


def key_of(name: str) -> str:
    """Key of the configuration that a variable sets."""
    return name[len(PREFIX) :].lower().replace("__", ".")


def _names() -> list[str]:
    return sorted(name for name in os.environ if name.upper().startswith(PREFIX))


def _error(settings: type[BaseSettings], name: str) -> str:
    section, value = key_of(name).partition(".")[0], os.environ[name].strip()
    known = [key for key, field in settings.model_fields.items() if not field.exclude]
    if section not in known:
        return f"{name}: no section {section!r}; {suggestion(section, known)}"
    if len(value) > 1 and value[0] == value[-1] and value[0] in _QUOTES:
        return (
            f"{name}: in quotes, which an --env-file of a container leaves as they are; expected "
            "the value without them"
        )
    source = EnvSettingsSource(settings)
    source.env_vars = {name.lower(): os.environ[name]}
    try:
        source()
    except UnreadableVariableError:
        return f'{name}: expected JSON text, such as ["127.0.0.1"]'
    return ""
