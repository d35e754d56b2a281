"""Assets are taken up whole, whatever fails in the middle of it."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import pytest

from service.cell.stored_assets import AssetActions, StoredAssets
from service.site.asset_tables import CheckedAsset
from service.site.settings import load_settings
from service.site.wiring import Wiring
from service.store import Store, StoreUnavailableError

CONFIGURATION = """
[[templates]]
name = "axle"
bearing = "6311"
low_risk = { speed_rpm_max = 4300, load_n_max = 3400 }
[templates.channels]
t_inner_ring_c = { source = "push" }
speed_rpm = { source = "push" }
load_n = { source = "push" }
"""
AXLE = {"template": "axle"}


class Hall:
    """Follows what it is told to; what is in `fails` raises once."""

    def __init__(self, folder: Path, text: str = CONFIGURATION) -> None:
        self.file = file = folder / "twin.toml"
        file.write_text(text)
        (folder / "var").mkdir(exist_ok=True)
        self.store = Store.open("", folder)
        self.followed: dict[str, str] = {}
        self.changes = 0
        self.read: set[str] = set()
        self.fails: set[str] = set()
        self.stored_assets = StoredAssets(
            load_settings(file), self.store, AssetActions(self.follow, self.read_for)
        )
        for name, one in self.stored_assets.first().items():
            self.followed[name] = one.section.name

    def _may_fail(self, what: str) -> None:
        if what in self.fails:
            self.fails.remove(what)
            raise StoreUnavailableError("the disk is away")

    async def follow(
        self, gone: Sequence[str], left: Sequence[str], given: Sequence[CheckedAsset]
    ) -> None:
        if gone or given:
            self._may_fail("follow")
        for name in gone:
            self.followed.pop(name, None)
        self.followed |= {one.section.id: one.section.name for one in given}
        self.changes += len(gone) + len(given)

    async def read_for(self, assets: Mapping[str, Wiring | None]) -> None:
        self._may_fail("read")
        for name, wiring in assets.items():
            self.read.discard(name) if wiring is None else self.read.add(name)

    def change(self, **tables: Mapping[str, object] | None) -> int:
        return self.store.assets.change(tables, 1)


@pytest.fixture
def hall(tmp_path: Path) -> Iterator[Hall]:
    hall = Hall(tmp_path)
    yield hall
    hall.store.close()


@pytest.mark.parametrize("step", ["follow", "read"])
async def test_what_fails_in_the_middle_is_done_with_the_next_look(hall: Hall, step: str) -> None:
    hall.change(kept=AXLE, left=AXLE, other=AXLE)
    assert await hall.stored_assets.apply() == {}
    revision = hall.change(left=None, other=AXLE | {"name": "Other"}, new=AXLE)
    hall.fails.add(step)
    with pytest.raises(StoreUnavailableError):
        await hall.stored_assets.apply()
    assert hall.stored_assets.revision < revision
    assert await hall.stored_assets.apply() == {}
    assert hall.stored_assets.revision == revision
    assert hall.followed == {"kept": "", "other": "Other", "new": ""}
    assert hall.read == {"kept", "other", "new"}


async def test_a_table_that_says_the_same_begins_nothing_anew(hall: Hall) -> None:
    hall.change(axle=AXLE)
    await hall.stored_assets.apply()
    before = hall.changes
    hall.change(axle=AXLE | {"name": ""})
    assert await hall.stored_assets.apply() == {}
    assert (hall.followed, hall.changes) == ({"axle": ""}, before)


async def test_a_table_that_became_wrong_is_named_until_it_is_right(hall: Hall) -> None:
    hall.change(axle=AXLE, right=AXLE)
    await hall.stored_assets.apply()
    hall.change(axle={"template": "axel"})
    wrong = await hall.stored_assets.apply()
    assert "did you mean 'axle'" in wrong["axle"]
    assert hall.stored_assets.problem == f"axle: {wrong['axle']}"
    assert hall.followed == {"right": ""}
    hall.change(axle=None)
    assert await hall.stored_assets.apply() == {}
    assert hall.stored_assets.problem is None


async def test_what_stands_in_the_file_too_is_that_of_the_file(hall: Hall) -> None:
    in_file = CONFIGURATION + '\n[[assets]]\nid = "axle"\ntemplate = "axle"\n'
    hall.change(axle=AXLE | {"name": "of the store"}, other=AXLE)
    again = Hall(hall.file.parent, in_file)
    assert again.followed == {"other": ""}
    assert "stands in the configuration file" in str(again.stored_assets.problem)
    again.read = {"axle", "other"}
    again.change(axle=None)
    assert await again.stored_assets.apply() == {}
    assert again.read == {"axle", "other"}, "the file's asset is read on"
    assert again.changes == 0
    again.store.close()


async def test_what_the_store_holds_at_the_start_is_followed(hall: Hall, tmp_path: Path) -> None:
    revision = hall.change(axle=AXLE, wrong={"template": "axel"})
    again = Hall(tmp_path)
    assert again.followed == {"axle": ""}
    assert again.stored_assets.revision == revision
    assert again.stored_assets.problem is not None
    again.store.close()


HOLE = CONFIGURATION.replace('bearing = "6311"', 'bearing = "6311"\ngroup = "Line {depot}"')


def named(count: int, **values: str) -> dict[str, Mapping[str, object]]:
    table = AXLE | ({"values": values} if values else {})
    return {f"axle-{number}": table for number in range(count)}


async def test_a_template_with_a_hole_stops_nothing(hall: Hall, tmp_path: Path) -> None:
    hall.change(**named(20), other={"template": "axel"})
    first = Hall(tmp_path)
    first.store.close()
    assert (len(first.followed), first.stored_assets.newly_kept) == (20, set())
    for start in ("the first", "the second"):
        again = Hall(tmp_path, HOLE)
        assert again.followed == dict.fromkeys(named(20), ""), start
        assert not again.stored_assets.follows_nothing
        problem = str(again.stored_assets.problem)
        assert "other: other.template" in problem
        assert "20 assets do not fit the configuration and are followed by the templates" in problem
        assert "values.depot: missing; template 'axle' asks for it; and 17 more" in problem
        newly = set(named(20)) if start == "the first" else set()
        assert again.stored_assets.newly_kept == newly, "said once, not at each start"
        again.store.close()
    # What is changed is judged by the configuration as it is; the others go on.
    again = Hall(tmp_path, HOLE)
    again.change(**{"axle-1": {"template": "axle", "values": {"depot": "North"}}, "axle-2": AXLE})
    assert set(await again.stored_assets.apply()) == {"axle-2", "other"}
    assert set(again.followed) == set(named(20)) - {"axle-2"}
    assert "18 assets do not fit" in str(again.stored_assets.problem)
    again.store.close()
    # The hole is closed: all are followed by it, and it is the one to be kept.
    mended = Hall(tmp_path)
    assert set(mended.followed) == set(named(20)) - {"axle-1"}
    mended.store.close()


async def test_a_few_assets_that_fit_no_more_are_followed_no_more(
    hall: Hall, tmp_path: Path
) -> None:
    hall.change(**named(18, depot="North"), old=AXLE, older=AXLE)
    Hall(tmp_path).store.close()
    again = Hall(tmp_path, HOLE)
    assert set(again.followed) == set(named(18)), "2 of 20 are no more than a tenth"
    assert again.stored_assets.newly_kept == set()
    again.store.close()


@pytest.mark.parametrize("damage", ["", "{", "[]", '{"templates": 1, "bearings": 2, "kept": 3}'])
async def test_where_nothing_was_kept_no_asset_is_followed_and_it_says_so(
    hall: Hall, tmp_path: Path, damage: str
) -> None:
    hall.change(**named(2))
    kept = tmp_path / "var" / "templates.json"
    kept.unlink()
    if damage:
        kept.write_text(damage)
    again = Hall(tmp_path, HOLE)
    assert again.followed == {}
    assert again.stored_assets.follows_nothing
    again.store.close()
    in_file = Hall(
        tmp_path, HOLE + '\n[[assets]]\nid = "x"\ntemplate = "axle"\nvalues.depot = "N"\n'
    )
    assert not in_file.stored_assets.follows_nothing
    in_file.store.close()


def test_a_name_of_control_characters_that_was_stored_before_is_followed(tmp_path: Path) -> None:
    hall = Hall(tmp_path)
    hall.change(axle=AXLE | {"name": "a\x1b[31m\u202eb"})
    hall.store.close()
    hall = Hall(tmp_path)
    assert hall.followed == {"axle": "a\x1b[31m\u202eb"}
    assert hall.stored_assets.problem is None
    hall.store.close()
