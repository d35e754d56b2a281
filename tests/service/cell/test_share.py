"""Several cells over one store: no device is ever read by two of them, whatever moves."""

import asyncio
import random
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, cast

import pytest

from service.cell.share import Share
from service.cell.stored_assets import AssetActions, StoredAssets
from service.site.asset_tables import CheckedAsset, wire_sources
from service.site.settings import load_settings
from service.site.wiring import Wiring
from service.store import Store
from service.store.ownership import Ownership

PARTITIONS = 4
GATEWAYS = 5
CONFIGURATION = (
    "\n".join(
        f'[[sources]]\nname = "gateway-{number}"\ndriver = "modbus-tcp"\nhost = "127.0.0.1"'
        for number in range(GATEWAYS)
    )
    + """
[[templates]]
name = "axle"
bearing = "6311"
low_risk = { speed_rpm_max = 4300, load_n_max = 3400 }
[templates.channels]
t_inner_ring_c = { source = "push" }
speed_rpm = { source = "push" }
load_n = { source = "push" }

[[assets]]
id = "of-the-file"
template = "axle"
"""
)


class Board:
    """Who owns what, as PostgreSQL would say."""

    def __init__(self) -> None:
        self.owner: dict[int, Cell | None] = dict.fromkeys(range(PARTITIONS))
        self.cells: list[Cell] = []


class Owned:
    """What a cell sees of the board; stands for `service.store.ownership.Ownership`."""

    count = PARTITIONS

    def __init__(self, board: Board, cell: "Cell") -> None:
        self._board, self._cell = board, cell
        self.leaving: frozenset[int] = frozenset()
        self.assets_revision = 0

    @property
    def owned(self) -> Mapping[int, int]:
        return {id: 1 for id, owner in self._board.owner.items() if owner is self._cell}

    @property
    def least_revision(self) -> int:
        return min(cell.ownership.assets_revision for cell in self._board.cells)

    def leave(self, partitions: frozenset[int]) -> None:
        for partition in partitions:
            self._board.owner[partition] = None
        self.leaving -= partitions


class Cell:
    """Follows what its share of the assets tells it to."""

    def __init__(self, file: Path, store: Store, board: Board) -> None:
        self.followed: dict[str, CheckedAsset] = {}
        self.ownership = Owned(board, self)
        board.cells.append(self)
        share = Share(cast(Ownership, self.ownership), asyncio.Event())
        site = AssetActions(self.follow, self.read)
        self.stored_assets = StoredAssets(load_settings(file), store, site, share)
        assert not self.stored_assets.first(), "nothing is followed before it is owned"

    async def follow(
        self, gone: Sequence[str], left: Sequence[str], given: Sequence[CheckedAsset]
    ) -> None:
        for name in (*gone, *left):
            del self.followed[name]
        self.followed |= {one.section.id: one for one in given}

    async def read(self, assets: Mapping[str, Wiring | None]) -> None:
        pass

    def devices(self) -> set[str]:
        return {
            device
            for name, one in self.followed.items()
            for device in (wire_sources(one.section) or {f"pushes of {name}"})
        }


def table(sources: Sequence[int]) -> dict[str, Any]:
    names = ("t_inner_ring_c", "speed_rpm", "load_n")
    return {
        "template": "axle",
        "channels": {
            name: {"source": f"gateway-{number}", "unit_id": 1, "register": place, "kind": "input"}
            for place, (name, number) in enumerate(zip(names, sources, strict=False))
        },
    }


@pytest.mark.parametrize("seed", range(4))
async def test_no_device_has_two_readers_and_all_have_one_in_the_end(
    tmp_path: Path, seed: int
) -> None:
    chance = random.Random(seed)
    file = tmp_path / "twin.toml"
    file.write_text(CONFIGURATION)
    board = Board()
    with Store.open("", tmp_path) as store:
        cells = [Cell(file, store, board) for _ in range(3)]

        def change() -> None:
            name = f"axle-{chance.randrange(8)}"
            sources = chance.sample(range(GATEWAYS), chance.choice([0, 1, 1, 2]))
            store.assets.change({name: chance.choice([table(sources), None])}, 1)

        def take() -> None:
            free = [one for one, owner in board.owner.items() if owner is None]
            if free:
                board.owner[chance.choice(free)] = chance.choice(cells)

        def give_up() -> None:
            cell = chance.choice(cells)
            owned = list(cell.ownership.owned)
            if owned:
                cell.ownership.leaving |= {chance.choice(owned)}

        for _ in range(250):
            action = chance.choice([change, take, give_up, None, None, None])
            if action is None:
                await chance.choice(cells).stored_assets.apply()
            else:
                action()
            readers = [device for cell in cells for device in cell.devices()]
            assert len(readers) == len(set(readers))
        for _ in range(3):
            while None in board.owner.values():
                take()
            for cell in cells:
                await cell.stored_assets.apply()
        followed = {name for cell in cells for name in cell.followed}
        kept = {one.id for one in store.assets.changed_since(0) if one.table is not None}
        assert followed == kept | {"of-the-file"}
