"""What a cell does for whom, whoever asks; and what it does not unpack."""

import asyncio
import os
import tracemalloc
import zlib
from typing import Any, Protocol

import pytest

from service.bus import commands
from service.bus.asking import caller_role
from service.bus.calls import call, command_type, commands_of
from service.bus.memory import MemoryBus
from service.bus.nats_bus import UNPACKED_MAX, packed, unpacked
from service.domain.errors import RoleRefusedError
from service.domain.roles import ROLES
from service.feature_folders import modules

INTERFACES = [
    one
    for module in (commands, *(feature for _, feature in modules("interface")))
    for one in vars(module).values()
    if Protocol in getattr(one, "__bases__", ())
]
KINDS = {kind.__name__: kind for one in INTERFACES for _, kind in commands_of(one)}
#: By hand, as docs/run/security.md gives the least role of each route.
ENGINEERS = {
    "Assets.renew_grease",
    "Notifications.test",
    "Identifications.create",
    "Identifications.cancel",
    "Identifications.activate",
    "Assets.apply",
}
ALLOWED = {
    **{name: {"engineer", "admin"} for name in ENGINEERS},
    "Alarms.acknowledge": {"operator", "engineer", "admin"},
    "Alarms.act": {"operator", "engineer", "admin"},
    "Pushes.take": {"gateway", "admin"},
}


def test_whatever_changes_something_asks_for_a_role() -> None:
    assert len(KINDS) > 15
    assert {name for name, kind in KINDS.items() if kind.call.roles is not None} == set(ALLOWED)
    audited = {name for name, kind in KINDS.items() if "audit" in kind.__struct_fields__}
    assert audited <= set(ALLOWED), "who has a line of the audit trail written has a role"
    for name, allowed in ALLOWED.items():
        fields = KINDS[name].__struct_fields__
        command = KINDS[name](*("comment" if one == "action" else None for one in fields))
        assert {role for role in (*ROLES, "") if command.may_be_asked_for(role)} == allowed, name


@pytest.mark.parametrize("action", ["take_out_of_service", "return_to_service", "shelve"])
def test_some_actions_on_alarms_are_for_engineers(action: commands.AlarmAction) -> None:
    command = call(commands.Alarms.act, "x", action, "eva", "")
    allowed = {role for role in (*ROLES, "") if command.may_be_asked_for(role)}
    expected = {"engineer", "admin"} | ({"operator"} if action == "shelve" else set())
    assert allowed == expected


async def test_a_cell_refuses_what_the_role_does_not_allow_and_does_nothing() -> None:
    bus, done = MemoryBus(), []
    cancelling = call(commands.Identifications.cancel, "a", "1")

    async def cancel(command: Any) -> None:
        done.append(command.job_id)

    async def names(_: Any) -> dict[str, int]:
        return {"a": 1}

    serving = asyncio.create_task(
        bus.serve(
            {
                command_type(commands.Identifications.cancel): cancel,
                command_type(commands.Assets.names): names,
            }
        )
    )
    await asyncio.sleep(0)
    try:
        for role in ("", "viewer", "operator", "gateway", "root"):
            caller_role.set(role)
            with pytest.raises(RoleRefusedError, match=r"Identifications\.cancel: not for role"):
                await bus.ask(cancelling, 5.0)
            assert await bus.ask(call(commands.Assets.names), 5.0) == {"a": 1}
        assert done == []
        caller_role.set("engineer")
        assert await bus.ask(cancelling, 5.0) is None
        assert done == ["1"]
    finally:
        serving.cancel()


def test_what_would_unpack_to_gigabytes_is_not_unpacked() -> None:
    bomb = b"\1" + zlib.compress(bytes(20 * UNPACKED_MAX), 9)
    assert len(bomb) < 1_000_000
    tracemalloc.start()
    try:
        assert unpacked(bomb) == b""
        assert tracemalloc.get_traced_memory()[1] < 3 * UNPACKED_MAX
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("size", [0, 100, 100_000, UNPACKED_MAX - 1, UNPACKED_MAX])
def test_messages_of_ours_are_unpacked_as_they_were(size: int) -> None:
    body = os.urandom(size // 2) + bytes(size - size // 2)
    assert unpacked(packed(body)) == body


@pytest.mark.parametrize("body", [b"", b"\1", b"\2x", b"\1" + zlib.compress(b"x" * 99)[:-6]])
def test_what_is_no_message_is_an_empty_one(body: bytes) -> None:
    assert unpacked(body) == b""
