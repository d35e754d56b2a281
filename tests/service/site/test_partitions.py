"""Assets that share a source, through however many steps, are never parted."""

import itertools

from hypothesis import given
from hypothesis import strategies as st
from site_files import asset_table

from service.site.asset_section import AssetSection
from service.site.partitions import partitions_of

SOURCES = [f"gateway-{number}" for number in range(6)]


def asset(name: str, sources: list[str]) -> AssetSection:
    names = ("t_outer_ring_c", "speed_rpm", "load_n")
    channels = zip(names, [*sources, "push", "push"], strict=False)
    table = {channel: {"source": source} for channel, source in channels}
    return AssetSection.model_validate(asset_table(name) | {"channels": table})


FLEETS = st.lists(st.lists(st.sampled_from(SOURCES), max_size=3, unique=True), max_size=12).map(
    lambda fleet: [asset(f"axle-{number}", sources) for number, sources in enumerate(fleet)]
)


@given(FLEETS, st.randoms())
def test_a_device_has_one_reader(fleet: list[AssetSection], random: object) -> None:
    found = partitions_of(fleet, 64)
    assert found.keys() == {one.id for one in fleet}
    for one, other in itertools.combinations(fleet, 2):
        shared = {
            table["source"] for table in one.channels.values() if table["source"] != "push"
        } & {table["source"] for table in other.channels.values()}
        if shared:
            assert found[one.id] == found[other.id]
    shuffled = list(fleet)
    random.shuffle(shuffled)  # type: ignore[attr-defined]
    assert partitions_of(shuffled, 64) == found


def test_pushed_assets_and_gateways_spread() -> None:
    fleet = [asset(f"pushed-{number}", []) for number in range(500)]
    counts = [list(partitions_of(fleet, 8).values()).count(partition) for partition in range(8)]
    assert min(counts) > 30


def test_an_asset_with_two_sources_joins_them() -> None:
    apart = [asset("one", ["gateway-1"]), asset("two", ["gateway-4"])]
    before = partitions_of(apart, 1024)
    assert before["one"] != before["two"]
    joined = partitions_of([*apart, asset("both", ["gateway-4", "gateway-1"])], 1024)
    assert joined["one"] == joined["two"] == joined["both"] == before["one"]
