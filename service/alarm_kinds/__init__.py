"""The alarm kinds, one file each; a file here is a kind as soon as it is there.

``KINDS`` holds them by name, and `AlarmsSection` is ``[assets.alarms]`` of the configuration with a
table for each of them. `docs/operate/alarms.md` lists the keys. Delays, states and the journal
belong to `service.alarms`.
"""

from collections.abc import Iterable, Mapping
from importlib import import_module
from pkgutil import iter_modules
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from pydantic import Field, create_model

from service.domain.alarm_kind import AlarmKind, Rule
from service.domain.section import Section


def _kinds() -> Iterable[AlarmKind[Any]]:
    for module in iter_modules(__path__):
        kind: AlarmKind[Any] = import_module(f"{__name__}.{module.name}").KIND
        if kind.key != module.name:
            raise TypeError(f"{module.name}.py: KIND is {kind.name!r}; expected the file's name")
        yield kind


KINDS: Mapping[str, AlarmKind[Any]] = MappingProxyType({kind.name: kind for kind in _kinds()})


class _AlarmsSection(Section):
    """All kinds of alarms of an asset."""

    #: Below this measured speed the machine is at standstill. The plant's own choice, lower than
    #: the twin's `STANDING_RPM`: nothing is suppressed while the machine turns.
    standstill_rpm: float = Field(5.0, ge=0, le=1000)

    def rule(self, kind: AlarmKind[Rule]) -> Rule:
        """Settings of a kind."""
        rule: Rule = getattr(self, kind.key)
        return rule


if TYPE_CHECKING:
    AlarmsSection = _AlarmsSection
else:
    AlarmsSection = create_model(
        "AlarmsSection",
        __base__=_AlarmsSection,
        __doc__=_AlarmsSection.__doc__,
        **{kind.key: (kind.rule, kind.rule()) for kind in KINDS.values()},
    )
