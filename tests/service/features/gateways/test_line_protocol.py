"""Lines as any client may send them: each is stored, or named."""

from hypothesis import example, given
from hypothesis import strategies as st

from adapters.times import EARLIEST_US
from service.features.gateways.line_protocol import judge_lines
from service.web.api.pushes import Judge

NOW_US = 1_764_144_000_000_000
CHANNELS = {"t_inner_ring_c": "push", "speed rpm": "push", "load_n": "plc"}


def judged(text: str) -> tuple[int, list[int], list[str]]:
    judge = Judge(NOW_US, 0)
    push, line_of = judge_lines(text, 1, {"rig-2": CHANNELS}.get, judge, 20_000)
    wrong = [f"{line_of[one.index]}: {one.detail}" for one in push.rejected]
    return push.count, line_of, wrong


@given(st.text())
@example("rig-2 t_inner_ring_c=1")
@example('rig-2 t_inner_ring_c="a\nb"')
@example("rig-2," * 10_000)
@example("\ud800")
def test_any_text_is_read_or_named(text: str) -> None:
    text = text.encode("utf-8", "replace").decode()
    count, line_of, wrong = judged(text)
    assert count + len(wrong) == len(line_of)
    assert all(1 <= number <= text.count("\n") + 1 for number in line_of)


@given(
    value=st.floats(allow_nan=False, allow_infinity=False, allow_subnormal=False),
    time_ns=st.integers(EARLIEST_US * 1000, NOW_US * 1000),
)
def test_what_a_client_writes_is_what_is_stored(value: float, time_ns: int) -> None:
    judge = Judge(NOW_US, 0)
    line = f"rig-2,a=b t_inner_ring_c={value!r},speed\\ rpm=3i {time_ns}"
    push, _ = judge_lines(line, 1, {"rig-2": CHANNELS}.get, judge, 9)
    assert not push.rejected
    samples, _ = push.packed
    found = {one.channel: (one.value, one.time_us) for one in samples.unpack(NOW_US, 0, 9)}
    assert found == {
        "t_inner_ring_c": (value, time_ns // 1000),
        "speed rpm": (3.0, time_ns // 1000),
    }


def test_each_wrong_line_has_its_number() -> None:
    _, _, wrong = judged("rig-2 load_n=1\n\n# note\nrig-2\nother x=1")
    assert [text[:2] for text in wrong] == ["1:", "4:", "5:"]
