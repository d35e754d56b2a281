"""Assets of the store: followed, changed and left as they are made, changed and removed there."""

import asyncio
import contextlib
from collections.abc import Awaitable, Callable, Collection, Mapping, Sequence
from dataclasses import dataclass

import structlog
from anyio import to_thread

from service.cell.known_assets import keep_copy
from service.cell.last_templates import check_at_start, keep_last
from service.cell.share import Share
from service.live.guard import Guard
from service.site.asset_tables import CheckedAsset, check_assets, of_section
from service.site.configuration import TomlTable
from service.site.settings import Settings
from service.site.wiring import Wiring
from service.store import ProvisionedAsset, Store, StoreUnavailableError

#: Wall seconds between two looks into the store: a command writes there without asking the cell.
LOOK_EVERY_WALL_S = 2.0
_NAMED = 3

_log = structlog.get_logger(__name__)


@dataclass(frozen=True, slots=True)
class AssetActions:
    """What is done with assets.

    Attributes
    ----------
    follow
        Follows some assets no longer, since they were removed; leaves others to another cell; and
        follows others from now on or by another table; all or nothing.
    read
        Reads other channels for some assets; None: nothing.
    """

    follow: Callable[[Sequence[str], Sequence[str], Sequence[CheckedAsset]], Awaitable[None]]
    read: Callable[[Mapping[str, Wiring | None]], Awaitable[None]]


class StoredAssets:
    """Keeps the assets of the cell those of the file and of the store.

    Parameters
    ----------
    settings : Settings
        With the assets of the file, and what those of the store may name.
    store : Store
        Where the others are.
    site : AssetActions
        What is done with them.
    share : Share, optional
        Which of them this cell follows, where several cells share them; None: all.

    Attributes
    ----------
    revision : int
        Of the latest change that is taken up.
    newly_kept : set of str
        Assets that are followed by the last templates since this start.
    """

    def __init__(
        self, settings: Settings, store: Store, actions: AssetActions, share: Share | None = None
    ) -> None:
        self.revision = 0
        self._share = share
        self._settings = settings
        self._store = store
        self._actions = actions
        # All that there are besides those that run from the start, and those that run now.
        self._known: dict[str, CheckedAsset] = {}
        self._running: dict[str, CheckedAsset] = {}
        self._wrong: dict[str, str] = {}
        # Followed by the templates before, and what is wrong with them by those of now.
        self._kept: dict[str, str] = {}
        self.newly_kept: set[str] = set()
        self._tables: dict[str, TomlTable] = {}
        self._applying = asyncio.Lock()

    @property
    def problem(self) -> str | None:
        """Which assets of the store cannot be followed and why; None when all are."""
        parts = [_named(self._wrong)] if self._wrong else []
        if self._kept:
            parts.append(
                f"{len(self._kept)} assets do not fit the configuration and are followed by the "
                f"templates before: {_named(self._kept)}"
            )
        return "; ".join(parts) or None

    @property
    def follows_nothing(self) -> bool:
        """Whether there are assets, and none of them can be followed."""
        return bool(self._wrong) and not self._known and not self._settings.assets

    def first(self) -> Mapping[str, CheckedAsset]:
        """Take up what there is at the start; reads from the store."""
        changed = self._store.assets.changed_since(0)
        self._tables = {one.id: one.table for one in changed if one.table is not None}
        checked = check_at_start(self._settings, self._tables)
        self._known, self._wrong, self._kept = checked.right, checked.wrong, checked.kept
        self._keep_copy()
        self.newly_kept = keep_last(self._settings, self._kept)
        if self._kept:
            _log.error("last_templates_kept", assets=len(self._kept), reason=_named(self._kept))
        self.revision = max((one.revision for one in changed), default=0)
        for name, why in self._wrong.items():
            _log.error("asset_not_followed", asset=name, reason=why)
        if self._share is None:
            self._running = dict(self._known)
        else:
            of_file = {one.id: of_section(self._settings, one) for one in self._settings.assets}
            self._known = of_file | self._known
            self._arrange(self._known, max((one.revision for one in changed), default=0))
        return self._running

    def wirings(self) -> dict[str, Wiring | None]:
        """What is read for the assets of the store."""
        return {name: one.wiring for name, one in self._running.items()}

    async def follow(self) -> None:
        """Take up what others write into the store, until cancelled."""
        looking = Guard("taking_up_assets", "")
        while True:
            if self._share is None:
                await asyncio.sleep(LOOK_EVERY_WALL_S)
            else:
                with contextlib.suppress(TimeoutError):
                    async with asyncio.timeout(LOOK_EVERY_WALL_S):
                        await self._share.changed.wait()
                self._share.changed.clear()
            # Assets that are followed go on, whatever is wrong with a new one. The writer of
            # samples reports a store that is not reachable.
            with looking(), contextlib.suppress(StoreUnavailableError):
                await self.apply()

    async def apply(self) -> dict[str, str]:
        """Take up what has changed in the store; returns what cannot be followed, and why.

        Raises
        ------
        StoreUnavailableError
            If the store does not answer.
        """
        # It ends even if the caller leaves: what is read and what is followed must agree.
        return await asyncio.shield(asyncio.ensure_future(self._apply()))

    async def _apply(self) -> dict[str, str]:
        async with self._applying:
            changed = await to_thread.run_sync(self._store.assets.changed_since, self.revision)
            if not changed and self._share is None:
                return dict(self._wrong)
            names = {one.id for one in changed}
            known, wrong, revision = self._known, self._wrong, self.revision
            if changed:
                right, now_wrong = await to_thread.run_sync(self._checked, changed)
                in_file = {asset.id for asset in self._settings.assets}
                kept = {
                    name: one for name, one in known.items() if name not in names or name in in_file
                }
                known = kept | right
                wrong = {name: why for name, why in wrong.items() if name not in names} | now_wrong
                revision = max(one.revision for one in changed)
                await to_thread.run_sync(self._arrange, known, revision)
            await self._take_up(names, known)
            # Only now: what fails is done again with the next look.
            self._known, self._wrong = known, wrong
            self._kept = {name: why for name, why in self._kept.items() if name not in names}
            if changed:
                await to_thread.run_sync(self._keep_tables, changed)
                self.revision = revision
            if self._share is not None:
                self._share.settle(self.revision)
            return dict(self._wrong)

    def _arrange(self, known: Mapping[str, CheckedAsset], revision: int) -> None:
        if self._share is not None:
            self._share.arrange([one.section for one in known.values()], revision)

    async def _take_up(self, changed: Collection[str], known: Mapping[str, CheckedAsset]) -> None:
        """Follow what is ours of all assets, and no others."""
        running, share = self._running, self._share
        ours = {name for name in known if share is None or share.owns(name)}
        given = [
            known[name]
            for name in known
            if name in ours
            and (
                name not in running
                or (name in changed and known[name].section != running[name].section)
            )
        ]
        gone = [name for name in running if name not in known]
        left = [name for name in running if name in known and name not in ours]
        if not (given or gone or left):
            return
        await self._actions.follow(gone, left, given)
        wirings: dict[str, Wiring | None] = dict.fromkeys([*gone, *left])
        await self._actions.read(wirings | {one.section.id: one.wiring for one in given})
        for name in (*gone, *left):
            running.pop(name, None)
        self._running = running | {one.section.id: one for one in given}
        _log.info(
            "assets_taken_up",
            taken=len(given),
            removed=len(gone),
            left_to_others=len(left),
            followed=len(self._running),
        )

    def _keep_tables(self, changed: Sequence[ProvisionedAsset]) -> None:
        for one in changed:
            if one.table is None:
                self._tables.pop(one.id, None)
            else:
                self._tables[one.id] = one.table
        self._keep_copy()

    def _keep_copy(self) -> None:
        keep_copy(self._settings.data_dir, self._tables)

    def _checked(
        self, changed: Sequence[ProvisionedAsset]
    ) -> tuple[dict[str, CheckedAsset], dict[str, str]]:
        tables = {one.id: one.table for one in changed if one.table is not None}
        right, wrong = check_assets(self._settings, tables)
        return right, {name: "; ".join(lines) for name, lines in wrong.items()}


def _named(assets: Mapping[str, str]) -> str:
    """Name the first of some assets with what is wrong with them."""
    named = [f"{name}: {why}" for name, why in list(assets.items())[:_NAMED]]
    others = len(assets) - len(named)
    return "; ".join(named) + (f"; and {others} more" if others else "")
