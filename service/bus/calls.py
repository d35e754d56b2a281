"""From the interface of a part of the cell: its commands, the proxy that asks, and what answers.

An interface is a `Protocol` of asynchronous methods with the decorator `Call`. What a method is
called, its parameters and its result are all that goes over the bus. A part of the cell implements
it, and any other process asks through a proxy; both are made here.
"""

import asyncio
import inspect
from collections.abc import Awaitable, Callable, Iterator
from functools import cache, partial
from types import SimpleNamespace
from typing import Any, Concatenate, ParamSpec, TypeVar, cast, get_type_hints

import msgspec

from service.bus.interface import Handlers
from service.bus.messages import Command, decoder_of

P = ParamSpec("P")
AnswerT = TypeVar("AnswerT")
InterfaceT = TypeVar("InterfaceT")


@cache
def command_type(method: Callable[..., Any]) -> type[Command[Any]]:
    """Make the type of the messages that call a method."""
    hints = get_type_hints(method)
    result = hints.pop("return")
    parameters = list(inspect.signature(method).parameters.values())[1:]
    fields = [
        (one.name, hints[one.name])
        if one.default is one.empty
        else (one.name, hints[one.name], one.default)
        for one in parameters
    ]
    kind = msgspec.defstruct(
        method.__qualname__,
        fields,
        bases=(Command,),
        module=method.__module__,
        namespace={"call": method.__dict__["call"], "result": decoder_of(result)},
        frozen=True,
        array_like=True,
    )
    return cast(type[Command[Any]], kind)


def commands_of(interface: type) -> Iterator[tuple[str, type[Command[Any]]]]:
    """Name of each method of an interface, and the type of its commands."""
    for name, method in vars(interface).items():
        if "call" in getattr(method, "__dict__", ()):
            yield name, command_type(method)


def call(
    method: Callable[Concatenate[Any, P], Awaitable[AnswerT]], *args: P.args, **kwargs: P.kwargs
) -> Command[AnswerT]:
    """Make the command that calls a method of an interface, as in ``call(Jobs.job, "a", "7")``."""
    return command_type(method)(*args, **kwargs)


def proxy(interface: type[InterfaceT], ask: Callable[[Command[Any]], Awaitable[Any]]) -> InterfaceT:
    """Make an object that has each method of an interface done by who answers commands."""

    def asking(kind: type[Command[Any]]) -> Callable[..., Awaitable[Any]]:
        return lambda *args, **kwargs: ask(kind(*args, **kwargs))

    methods = {name: asking(kind) for name, kind in commands_of(interface)}
    return cast(InterfaceT, SimpleNamespace(**methods))


def answering(interface: type[InterfaceT]) -> Callable[[InterfaceT], Handlers]:
    """How an implementation answers the commands of an interface: ``answering(Jobs)(jobs)``."""

    def handlers(implementation: InterfaceT) -> Handlers:
        return {
            kind: partial(_answer, getattr(implementation, name))
            for name, kind in commands_of(interface)
        }

    return handlers


async def _answer(method: Callable[..., Awaitable[Any]], command: Command[Any]) -> Any:
    answering = method(*arguments_of(command))
    if not command.call.finishes:
        return await answering
    return await asyncio.shield(asyncio.ensure_future(answering))


def arguments_of(command: Command[Any]) -> tuple[Any, ...]:
    """What a command calls its method with."""
    return msgspec.structs.astuple(command)
