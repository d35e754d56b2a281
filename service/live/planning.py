"""What helps to plan the next test on a machine: envelope and advice, off the event loop."""

import asyncio
from collections.abc import Callable, Collection, Mapping, Sequence

from service.documents.advice import AdviceDocument
from service.documents.envelope import EnvelopeDocument
from service.domain.errors import NotIdentifiedError, NotReadyError
from service.live.advice import give_advice
from service.live.envelope import EnvelopeKeeper, with_present
from service.live.estimate import EstimatedState
from service.site.settings import AssetSection
from twin_core.forecasting.advice import NothingIdentifiedError
from twin_core.forecasting.design import Level


class Planning:
    """Answers questions about points that the machine might be run at.

    Parameters
    ----------
    settings : AssetSection
        Low-risk region and limits.
    present : callable
        Gives the present state; None before there is one.
    measured : collection of str
        The asset's channels.
    """

    def __init__(
        self,
        settings: AssetSection,
        present: Callable[[], EstimatedState | None],
        measured: Collection[str],
    ) -> None:
        self._settings = settings
        self._present = present
        self._measured = tuple(measured)
        self._envelope = EnvelopeKeeper(settings)
        self._advising = asyncio.Lock()

    async def envelope(
        self,
        planned: Sequence[tuple[float, float]],
        measured_c: Mapping[str, float | None],
    ) -> EnvelopeDocument:
        """Safe operating envelope; its grid holds what is planned.

        Parameters
        ----------
        planned : sequence of (float, float)
            Speeds in rpm and loads in N.
        measured_c : mapping of str to float or None
            Good and fresh readings by sensor.

        Raises
        ------
        NotReadyError
            While there is no estimate.
        """
        state = self._state()
        maps = await self._envelope.maps(state, planned)
        return with_present(maps, state.point, measured_c)

    async def advice(self, target: Level) -> AdviceDocument:
        """Low-risk steps, ranked by what they would teach about a point.

        Raises
        ------
        NotReadyError
            While there is no estimate.
        NotIdentifiedError
            While the active model is not identified.
        """
        try:
            async with self._advising:
                return await asyncio.to_thread(
                    give_advice, self._settings, self._state(), self._measured, target
                )
        except NothingIdentifiedError as error:
            raise NotIdentifiedError(str(error)) from error

    def _state(self) -> EstimatedState:
        state = self._present()
        if state is None:
            raise NotReadyError("the twin waits for the first good temperatures, speed and load")
        return state
