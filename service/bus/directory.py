"""Which assets a fleet has, whoever follows them: those of the file and of the store."""

import asyncio
import contextlib
from typing import Final

from anyio import to_thread

from service.site.settings import Settings
from service.store import Store, StoreUnavailableError

#: Wall seconds between two looks into the store.
_LOOK_EVERY_S: Final = 2.0


class Directory:
    """The ids of all assets of a fleet.

    Parameters
    ----------
    settings : Settings
        With the assets of the file.
    store : Store
        Where the others are.
    """

    def __init__(self, settings: Settings, store: Store) -> None:
        self._store = store
        self._ids = {asset.id for asset in settings.assets}
        self._of_file = frozenset(self._ids)
        self._revision = 0

    def ids(self) -> set[str]:
        """Ids of all assets, as they were known at the last look."""
        return self._ids

    def look(self) -> None:
        """Learn of changes; reads from the store.

        Raises
        ------
        StoreUnavailableError
            If the store does not answer.
        """
        changed = self._store.assets.changed_since(self._revision)
        if changed:
            gone = {one.id for one in changed if one.table is None} - self._of_file
            self._ids = (self._ids - gone) | {one.id for one in changed if one.table is not None}
            self._revision = max(one.revision for one in changed)

    async def follow(self) -> None:
        """Look again and again, until cancelled."""
        while True:
            with contextlib.suppress(StoreUnavailableError):
                await to_thread.run_sync(self.look, abandon_on_cancel=True)
            await asyncio.sleep(_LOOK_EVERY_S)
