"""Lists of alarms, which come in parts: thousands of alarms are too much for one step of a cell."""

from collections.abc import Awaitable, Callable

import msgspec

from service.bus.commands import AlarmsPart
from service.bus.messages import Command
from service.store import Alarm


async def parts_of(
    ask: Callable[[Command[AlarmsPart]], Awaitable[AlarmsPart]], command: Command[AlarmsPart]
) -> list[AlarmsPart]:
    """Ask until a list of alarms is whole."""
    parts = [await ask(command)]
    while parts[-1].next:
        parts.append(await ask(msgspec.structs.replace(command, after=parts[-1].next)))
    return parts


async def alarms_of(
    ask: Callable[[Command[AlarmsPart]], Awaitable[AlarmsPart]], command: Command[AlarmsPart]
) -> list[Alarm]:
    """Give the alarms of all parts."""
    return [alarm for part in await parts_of(ask, command) for alarm in part.alarms]
