"""Which assets a fleet has, in any cell: those of the file and of the store."""

import asyncio
import contextlib
from collections.abc import Collection
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
        self._ids = dict.fromkeys(asset.id for asset in settings.assets)
        self._of_file = frozenset(self._ids)
        self._revision = 0
        self._incarnation = ""

    def ids(self) -> Collection[str]:
        """Ids of all assets as they were known at the last look: first those of the file."""
        return self._ids.keys()

    def look(self) -> None:
        """Learn of changes; reads from the store.

        Raises
        ------
        StoreUnavailableError
            If the store does not answer.
        """
        incarnation = self._store.identity.incarnation()
        if incarnation != self._incarnation:
            # Of another store: its revisions are no continuation of those that are known.
            self._incarnation, self._revision = incarnation, 0
            self._ids = dict.fromkeys(name for name in self._ids if name in self._of_file)
        changed = self._store.assets.changed_since(self._revision)
        if changed:
            ids = dict(self._ids)
            for one in changed:
                if one.table is not None:
                    ids[one.id] = None
                elif one.id not in self._of_file:
                    ids.pop(one.id, None)
            self._ids = ids
            self._revision = max(one.revision for one in changed)

    async def follow(self) -> None:
        """Look again and again, until cancelled."""
        while True:
            with contextlib.suppress(StoreUnavailableError):
                await to_thread.run_sync(self.look, abandon_on_cancel=True)
            await asyncio.sleep(_LOOK_EVERY_S)
