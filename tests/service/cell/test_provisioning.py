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

    def __init__(self, folder: Path) -> None:
        file = folder / "twin.toml"
        file.write_text(CONFIGURATION)
        self.store = Store.open("", folder)
        self.followed: dict[str, str] = {}
        self.gone: list[str] = []
        self.read: set[str] = set()
        self.fails: set[str] = set()
        self.provisioning = Provisioning(
            load_settings(file), self.store, Site(self.add, self.remove, self.read_for)
        )
        for name, one in self.provisioning.first().items():
            self.followed[name] = one.section.name

    def _may_fail(self, what: str) -> None:
        if what in self.fails:
            self.fails.remove(what)
            raise StoreUnavailableError("the disk is away")

    async def add(self, added: Sequence[CheckedAsset]) -> None:
        self._may_fail("add")
        for one in added:
            assert one.section.id not in self.followed, "two twins of one machine"
            self.followed[one.section.id] = one.section.name

    async def remove(self, gone: Sequence[str], changed: Sequence[str]) -> None:
        for name in (*gone, *changed):
            self.followed.pop(name, None)
            self._may_fail("remove")
        self.gone += gone

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


@pytest.mark.parametrize("step", ["remove", "add", "read"])
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
    assert set(hall.gone) == {"left"}


async def test_a_table_that_says_the_same_begins_nothing_anew(hall: Hall) -> None:
    hall.change(axle=AXLE)
    await hall.provisioning.apply()
    hall.fails.add("remove")
    hall.change(axle=AXLE | {"name": ""})
    assert await hall.provisioning.apply() == {}
    assert hall.followed == {"axle": ""}


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


async def test_what_the_store_holds_at_the_start_is_followed(hall: Hall, tmp_path: Path) -> None:
    revision = hall.change(axle=AXLE, wrong={"template": "axel"})
    again = Hall(tmp_path)
    assert again.followed == {"axle": ""}
    assert again.provisioning.revision == revision
    assert again.provisioning.problem is not None
    again.store.close()
