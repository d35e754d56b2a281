"""The two faces of a bus: the cell's, and that of those who read from it."""

from collections.abc import AsyncIterator, Awaitable, Callable, Mapping
from typing import Any, Protocol

from service.bus.messages import AnswerT, CellState, Change, Command

Handler = Callable[[Any], Awaitable[Any]]
"""Answers a command; may raise an error of the domain."""

Handlers = Mapping[type[Command[Any]], Handler]
"""What answers which command."""

#: Wall seconds between two reports of the cell's state.
STATE_EVERY_S = 0.25
#: Wall seconds without a sign of the cell after which it counts as away.
AWAY_AFTER_S = 2.0
#: The topics of the cell's state, of the live messages, and of its health and metrics.
STATE_TOPIC = "state"
STREAM_TOPIC = "stream"
HEALTH_TOPIC = "health"
METRICS_TOPIC = "metrics"


class CellBus(Protocol):
    """The cell's face: it never waits for anybody.

    Attributes
    ----------
    epoch : str
        Names this start of the cell.
    """

    epoch: str

    def publish(self, topic: str, number: int, body: bytes) -> None:
        """Report a change; who reads too slowly loses it and sees that by its number.

        May be called from any thread.
        """

    def report(self, state: CellState) -> None:
        """Report from now on that the cell is in this state."""

    async def serve(self, handlers: Handlers) -> None:
        """Answer commands until cancelled.

        Of one caller and of all together a limited number are under way; the next one is refused.
        """


class ReaderBus(Protocol):
    """The face of the web side and the plant side."""

    @property
    def away_s(self) -> float:
        """Wall seconds since the last sign of the cell."""

    @property
    def epoch(self) -> str:
        """Of the cell that was last heard; empty before the first sign."""

    @property
    def state(self) -> CellState:
        """What the cell last reported of itself."""

    async def run(self) -> None:
        """Keep the connection until cancelled."""

    def changes(self, topic: str) -> AsyncIterator[Change]:
        """Give the changes of a topic as they come, from now on; some may be missing."""

    async def ask(self, command: Command[AnswerT], patience_s: float) -> AnswerT:
        """Have a command answered.

        Parameters
        ----------
        command : Command
            What is asked.
        patience_s : float
            Wall seconds that the answer may take.

        Raises
        ------
        CellUnavailableError
            If no answer came, or the cell refuses any more commands; whether the command took
            effect is not known then.
        Exception
            The error of the domain that the command ended in.
        """
