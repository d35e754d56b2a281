"""A push for many assets judges each sample as the push for one asset does, and loses none."""

from operator import attrgetter
from typing import Any

from hypothesis import example, given
from hypothesis import strategies as st

from adapters.samples import Sample
from service.bus.pushed_samples import PushedSamples
from service.clock import rfc3339
from service.features.gateways.judging import judge_rows
from service.web.api.pushes import Judge, judge

NOW_US = 1_764_144_000_000_000
KEPT_FROM_US = NOW_US - 86_400_000_000
ASSETS = {
    "rig-1": {"t_inner_ring_c": "push", "speed_rpm": "push", "load_n": "plc"},
    "rig-2": {"load_n": "push", "speed_rpm": "drive", "t_inner_ring_c": "push"},
}
_PASSED = [rfc3339(NOW_US - seconds * 1_000_000) for seconds in (1, 2, 3)]
_WRONG_TIMES = [
    rfc3339(KEPT_FROM_US - 1),
    rfc3339(NOW_US + 10**12),
    "2026-11-21T08:00:00",
    "",
    7,
    None,
    [],
]
_WRONG: st.SearchStrategy[Any] = st.none() | st.booleans() | st.text(max_size=3) | st.just([])


def _mostly(usual: st.SearchStrategy[Any], other: st.SearchStrategy[Any]) -> Any:
    return st.one_of(usual, usual, usual, other)


_rows = st.fixed_dictionaries(
    {
        "asset": _mostly(st.sampled_from(sorted(ASSETS)), _WRONG | st.just("gone")),
        "channel": _mostly(
            st.sampled_from(["t_inner_ring_c", "speed_rpm", "load_n"]), _WRONG | st.integers()
        ),
        "time": _mostly(st.sampled_from(_PASSED), st.sampled_from(_WRONG_TIMES)),
        "value": _mostly(st.floats(-1e3, 1e3), st.floats() | st.integers() | _WRONG),
    },
    optional={"quality": _mostly(st.integers(0, 255), st.integers() | st.floats() | _WRONG)},
)
_broken = st.builds(
    lambda row, gone: {name: row[name] for name in row if name != gone},
    _rows,
    st.sampled_from(["asset", "channel", "time", "value"]),
)


def _row(asset: str = "rig-1", value: Any = 1.0, **more: Any) -> dict[str, Any]:
    return {"asset": asset, "channel": "t_inner_ring_c", "time": _PASSED[0], "value": value} | more


def unpacked(samples: PushedSamples) -> list[Sample]:
    # A NaN is not equal to itself; a portion ends anywhere.
    half = len(samples) // 2
    rows = samples.unpack(NOW_US, 0, half) + samples.unpack(NOW_US, half, len(samples))
    return [shown(one) for one in rows]


def shown(sample: Sample) -> Sample:
    return sample._replace(value=repr(sample.value), quality=int(sample.quality))  # type: ignore[arg-type]


@given(st.lists(_mostly(_rows, _broken | _WRONG), max_size=40))
@example([_row(), _row(value=True), _row(value=2**53), _row(value=10**400), _row(value=-0.0)])
@example([_row(), _row(quality=True), _row(quality=192.0), _row(quality=256), _row(quality=63)])
@example([_row(), _row(value=None), _row(value=float("nan")), _row(value=float("inf"))])
@example([_row(), _row("rig-2"), _row("gone"), _row(channel=True), _row(time=True)])
def test_each_row_is_judged_as_a_push_of_one_asset_judges_it(rows: list[Any]) -> None:
    push = judge_rows(rows, ASSETS.get, Judge(NOW_US, KEPT_FROM_US))
    samples, too_old = map(unpacked, push.packed)
    wrong = {one.index: one.detail for one in push.rejected}
    assert len(wrong) == len(push.rejected) == len(rows) - push.count
    assert push.samples.assets() == {one.asset for one in samples}
    of_none = set(range(len(rows)))
    for asset, channels in ASSETS.items():
        places = [
            index
            for index, row in enumerate(rows)
            if isinstance(row, dict) and row.get("asset") == asset
        ]
        mine = [rows[index] for index in places]
        verdict = judge(mine, asset, channels, NOW_US, KEPT_FROM_US)
        assert [one for one in samples if one.asset == asset] == [*map(shown, verdict.samples)]
        old = sorted(verdict.too_old, key=attrgetter("time_us"))
        assert [one for one in too_old if one.asset == asset] == [*map(shown, old)]
        reasons = {places[one.index]: one.detail for one in verdict.rejected}
        assert {index: wrong[index] for index in places if index in wrong} == reasons
        of_none -= set(places)
    assert all(wrong[index].startswith(("asset ", "expected {")) for index in of_none)


@given(
    st.lists(
        st.tuples(st.sampled_from("abcde"), st.sampled_from("xy"), st.integers(0, 9)), max_size=40
    ),
    st.sets(st.sampled_from("abcdef")),
)
def test_each_part_has_the_samples_of_its_assets_in_order(
    rows: list[tuple[str, str, int]], wanted: set[str]
) -> None:
    samples = [
        Sample(asset, channel, time_us, float(number), 192, NOW_US)
        for number, (asset, channel, time_us) in enumerate(rows)
    ]
    whole = PushedSamples.of(samples)
    part, rest = whole.part(wanted), whole.part(set("abcdef") - wanted)
    assert len(part) + len(rest) == len(samples)
    assert {*part.assets} == {one.asset for one in samples} & wanted
    for asset in "abcde":
        expected = sorted((one for one in samples if one.asset == asset), key=attrgetter("time_us"))
        of = part if asset in wanted else rest
        found = of.unpack(NOW_US, 0, len(of))
        assert [one for one in found if one.asset == asset] == expected
