"""Assets are taken up whole, whatever fails in the middle of it."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import pytest

from service.cell.provisioning import Provisioning, Site
from service.site.provisioning import CheckedAsset
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
        self.store = Store.open("", folder)
        self.followed: dict[str, str] = {}
        self.changes = 0
        self.read: set[str] = set()
        self.fails: set[str] = set()
        self.provisioning = Provisioning(
            load_settings(file), self.store, Site(self.follow, self.read_for)
        )
        for name, one in self.provisioning.first().items():
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
    assert await hall.provisioning.apply() == {}
    revision = hall.change(left=None, other=AXLE | {"name": "Other"}, new=AXLE)
    hall.fails.add(step)
    with pytest.raises(StoreUnavailableError):
        await hall.provisioning.apply()
    assert hall.provisioning.revision < revision
    assert await hall.provisioning.apply() == {}
    assert hall.provisioning.revision == revision
    assert hall.followed == {"kept": "", "other": "Other", "new": ""}
    assert hall.read == {"kept", "other", "new"}


async def test_a_table_that_says_the_same_begins_nothing_anew(hall: Hall) -> None:
    hall.change(axle=AXLE)
    await hall.provisioning.apply()
    before = hall.changes
    hall.change(axle=AXLE | {"name": ""})
    assert await hall.provisioning.apply() == {}
    assert (hall.followed, hall.changes) == ({"axle": ""}, before)


async def test_a_table_that_became_wrong_is_named_until_it_is_right(hall: Hall) -> None:
    hall.change(axle=AXLE, right=AXLE)
    await hall.provisioning.apply()
    hall.change(axle={"template": "axel"})
    wrong = await hall.provisioning.apply()
    assert "did you mean 'axle'" in wrong["axle"]
    assert hall.provisioning.problem == f"axle: {wrong['axle']}"
    assert hall.followed == {"right": ""}
    hall.change(axle=None)
    assert await hall.provisioning.apply() == {}
    assert hall.provisioning.problem is None


async def test_what_stands_in_the_file_too_is_that_of_the_file(hall: Hall) -> None:
    in_file = CONFIGURATION + '\n[[assets]]\nid = "axle"\ntemplate = "axle"\n'
    hall.change(axle=AXLE | {"name": "of the store"}, other=AXLE)
    again = Hall(hall.file.parent, in_file)
    assert again.followed == {"other": ""}
    assert "stands in the configuration file" in str(again.provisioning.problem)
    again.read = {"axle", "other"}
    again.change(axle=None)
    assert await again.provisioning.apply() == {}
    assert again.read == {"axle", "other"}, "the file's asset is read on"
    assert again.changes == 0
    again.store.close()


async def test_what_the_store_holds_at_the_start_is_followed(hall: Hall, tmp_path: Path) -> None:
    revision = hall.change(axle=AXLE, wrong={"template": "axel"})
    again = Hall(tmp_path)
    assert again.followed == {"axle": ""}
    assert again.provisioning.revision == revision
    assert again.provisioning.problem is not None
    again.store.close()
