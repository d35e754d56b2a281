"""All assets of the cell as other processes see them, brought up to date together."""

import asyncio
import contextlib
import time
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Final

from service.bus.calls import call
from service.bus.commands import Assets, Wanted
from service.bus.interface import ReaderBus
from service.bus.questions import Questions
from service.bus.replica import FRESH_S, PATIENCE_S, AssetReplica, digest
from service.documents.interfaces import DocumentKind
from service.domain.errors import CellUnavailableError

#: Documents asked for at once: the answers about thousands of assets are too long for one message,
#: and take the cell longer than who asks waits.
PORTION: Final = 32
_ALL: Final[tuple[DocumentKind, ...]] = (
    "facts",
    "summary",
    "snapshot",
    "state",
    "verdict",
    "forecast",
    "asset_summary",
)
#: Wall seconds between two looks for other assets.
_LOOK_EVERY_S: Final = 0.25


@dataclass(slots=True)
class Replicas:
    """All assets of the cell.

    Attributes
    ----------
    assets : mapping of str to AssetReplica
        By id, in the order of the configuration; those that came later follow.
    names : collection of str
        Ids of all assets at the last look, also of those whose documents are not here yet.
    revision : str
        Another one when assets have come or gone, or the table of one has changed.
    """

    reader: ReaderBus
    questions: Questions | None = None
    fresh_s: float = FRESH_S
    assets: dict[str, AssetReplica] = field(default_factory=dict)
    names: Collection[str] = ()
    revision: str = ""
    _loaded: int = -1
    _numbers: dict[str, int] = field(default_factory=dict)
    _loading: asyncio.Lock = field(default_factory=asyncio.Lock)

    async def load(self) -> None:
        """Learn which assets there are; to be done again when that has changed.

        Raises
        ------
        CellUnavailableError
            If the cell does not answer.
        """
        async with self._loading:
            # Before asking: what comes meanwhile is learned with the next look.
            loaded = self.reader.state.assets
            numbers = await self.reader.ask(call(Assets.names), PATIENCE_S)
            new = {
                name: AssetReplica(name, self.reader, self.questions, self.fresh_s)
                for name, number in numbers.items()
                if self._numbers.get(name) != number
            }
            self.names = numbers.keys()
            # No client gets an asset whose documents are not here yet.
            await self._refresh(new.values(), _ALL)
            for gone in self.assets.keys() - numbers.keys():
                del self.assets[gone]
            # One that was removed meanwhile is not known, and never shown.
            self.assets |= {name: one for name, one in new.items() if _is_whole(one)}
            self._numbers = {name: numbers[name] for name in self.assets}
            self.revision = digest(repr(sorted(self._numbers.items())).encode()).hex()
            # Where documents did not come in time, or one was removed meanwhile, it is tried again.
            if len(self.assets) == len(numbers):
                self._loaded = loaded

    async def follow(self) -> None:
        """Learn it again whenever the cell has taken up other assets, until cancelled."""
        while True:
            await asyncio.sleep(_LOOK_EVERY_S)
            if self.reader.state.assets != self._loaded:
                with contextlib.suppress(CellUnavailableError):
                    await self.load()

    def changed(self, assets: Collection[str] | None) -> None:
        """Take no copy of some assets, or of any, from before this moment for fresh."""
        for name in self.assets if assets is None else assets:
            if name in self.assets:
                self.assets[name].changed()

    async def refresh(self, *kinds: DocumentKind, assets: Collection[str] | None = None) -> None:
        """Bring the documents of some assets, or of all, up to date, some with each question."""
        of = None if assets is None else [self.assets[one] for one in assets if one in self.assets]
        await self._refresh(list(self.assets.values()) if of is None else of, kinds)

    async def _refresh(self, assets: Iterable[AssetReplica], kinds: Sequence[DocumentKind]) -> None:
        due = [(asset, kind) for asset in assets for kind in kinds if asset.is_due(kind)]
        for begin in range(0, len(due), PORTION):
            await self.ask_for(due[begin : begin + PORTION])

    async def ask_for(self, portion: Sequence[tuple[AssetReplica, DocumentKind]]) -> None:
        """Bring some documents up to date with one question: `PORTION` of them at most."""
        wanted = [Wanted(asset.id, kind, asset.known_tag(kind)) for asset, kind in portion]
        asked_s = time.monotonic()
        documents = await self.reader.ask(call(Assets.documents, wanted), PATIENCE_S)
        for (asset, kind), document in zip(portion, documents, strict=True):
            asset.take(kind, document, asked_s)

    async def refresh_known(
        self, *kinds: DocumentKind, assets: Collection[str] | None = None
    ) -> None:
        """As `refresh`; where the cell does not answer what is known must do."""
        with contextlib.suppress(CellUnavailableError):
            await self.refresh(*kinds, assets=assets)


def _is_whole(asset: AssetReplica) -> bool:
    """Whether all is known that every asset has; one that goes while it is read lacks some."""
    return asset.is_known("summary") and asset.is_known("asset_summary")
