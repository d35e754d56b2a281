"""The permissive: 1 needs everything, and whatever is lost, in whatever way, gives 0."""

import math
from typing import Any

from hypothesis import given
from hypothesis import strategies as st

from adapters.samples import is_good
from service.plant.modbus_server.image import Image
from service.plant.modbus_server.register_map import PERMISSIVE, MappedTag, RegisterMap

INPUTS = ("speed_rpm", "load_n", "ambient_c", "t_inner_ring_c")
STANDS = {
    **dict.fromkeys(INPUTS, 40.0),
    "verdict.now": 1,
    "verdict.next_step": 1,
    "model.trusted": 1,
    "alarms.active": 0,
}
BEGAN = "2026-01-21T08:00:00.000Z"
MAP = RegisterMap({"bench-1": INPUTS}, [MappedTag("bench-1", "t_inner_ring_c")], 7)

numbers = st.one_of(
    st.none(),
    st.sampled_from([0, 1, 2, 3, 1.0, math.nan, math.inf]),
    st.floats(),
    st.integers(0, 3),
)
qualities = st.one_of(
    st.sampled_from([0, 28, 63, 64, 68, 83, 191, 192, 216, 255]), st.integers(0, 255)
)


def shown(value: float | None, quality: int = 192) -> dict[str, Any]:
    return {"value": value, "unit": "", "quality": quality, "time": BEGAN}


def permissive(tags: Any) -> bool:
    """As a PLC reads it, both ways."""
    image = Image(MAP, lambda asset: tags, lambda: 0)
    (bit,) = image.bits(0, 1) or ()
    (word,) = image.registers(PERMISSIVE, 1) or ()
    assert word == bit
    return bit


def test_it_is_1_while_everything_stands() -> None:
    tags = {name: shown(value) for name, value in STANDS.items()}
    assert permissive(tags)
    # Alarms do not take it: a limit alarm does by the verdict, others are the operator's.
    assert permissive({**tags, "alarms.active": shown(3), "vibration": shown(None, 0)})


@given(
    st.lists(
        st.tuples(
            st.sampled_from(sorted(STANDS)),
            st.one_of(
                st.none(),
                st.tuples(
                    st.none() | st.sampled_from([math.nan, math.inf, -math.inf]), st.just(192)
                ),
                st.tuples(st.just("same"), st.integers(0, 191)),
            ),
        ),
        min_size=1,
    )
)
def test_one_loss_is_enough_for_0(losses: list[tuple[str, Any]]) -> None:
    tags = {name: shown(value) for name, value in STANDS.items()}
    for name, loss in losses:
        if loss is None:
            tags.pop(name, None)
        else:
            value, quality = loss
            tags[name] = shown(STANDS[name] if value == "same" else value, quality)
    assert not permissive(tags)


@given(st.none() | st.dictionaries(st.sampled_from(sorted(STANDS)), st.tuples(numbers, qualities)))
def test_what_is_1_has_all_inputs_and_is_safe(given_tags: Any) -> None:
    tags = None
    if given_tags is not None:
        safe = {name: shown(value) for name, value in STANDS.items()}
        tags = safe | {name: shown(*one) for name, one in given_tags.items()}
    if permissive(tags):
        assert tags is not None
        assert all(is_good(tags[name]["quality"]) for name in STANDS)
        assert all(math.isfinite(tags[name]["value"]) for name in INPUTS)
        words = ("verdict.now", "verdict.next_step", "model.trusted")
        assert [tags[name]["value"] for name in words] == [1, 1, 1]
