"""Lines without transaction numbers: nothing but the answer to a request is taken for it."""

import asyncio
import struct
from collections import deque
from dataclasses import dataclass, field

import hypothesis
import pytest
from hypothesis import given
from hypothesis import strategies as st
from jumping import JumpingLoop

from adapters.drivers.modbus.serial_line import (
    DoubtError,
    Request,
    SerialLine,
    SilenceError,
    find_answer,
    holds_another_length,
    sealed,
)

TIMEOUT_S = 1.0
UNIT, INPUT = 1, 4


def request(register: int, count: int = 1, unit: int = UNIT, function: int = INPUT) -> Request:
    return Request(sealed(struct.pack(">BBHH", unit, function, register, count)), count)


def answer(value: int, unit: int = UNIT, function: int = INPUT) -> bytes:
    return sealed(struct.pack(">BBBH", unit, function, 2, value))


def value_of(register: int) -> int:
    """Every register has a value of its own."""
    return register * 7 + 1


@pytest.mark.parametrize("register", range(0x0300, 0x0400, 17))
def test_an_echo_is_no_answer(register: int) -> None:
    asked = request(register)
    assert find_answer(asked.frame, asked) is None
    assert find_answer(asked.frame + answer(351), asked) == (answer(351), 15)
    assert find_answer(asked.frame[:5], asked) is None


def test_what_another_master_asks_and_gets_is_no_answer() -> None:
    asked = request(0)
    stranger = request(0x0302).frame
    with pytest.raises(DoubtError, match="another master"):
        find_answer(stranger, asked)
    with pytest.raises(DoubtError, match="another master"):
        find_answer(stranger + answer(9), asked)
    other_unit = request(0x0302, unit=2).frame + answer(9, unit=2)
    assert find_answer(other_unit, asked) is None
    found = find_answer(other_unit + answer(351), asked)
    assert found is not None
    assert found[0] == answer(351)


def test_an_answer_of_another_length_unit_or_function_is_none() -> None:
    asked = request(0)
    for frame in (
        sealed(struct.pack(">BBBHH", UNIT, INPUT, 4, 1, 2)),
        answer(1, unit=2),
        answer(1, function=3),
        answer(1)[:-1],
        answer(1)[:-1] + b"\0",
    ):
        assert find_answer(frame, asked) is None
    refused = sealed(bytes((UNIT, INPUT | 0x80, 2)))
    assert find_answer(refused, asked) == (refused, 5)


def test_an_answer_of_another_length_is_told_from_none() -> None:
    longer = sealed(struct.pack(">BBBHH", UNIT, INPUT, 4, 1, 2))
    shorter = sealed(struct.pack(">BBB", UNIT, INPUT, 0))
    for heard in (longer, shorter, b"\xff" + longer + b"\0", request(9).frame + longer):
        assert holds_another_length(heard, request(0))
    for heard in (
        b"",
        answer(1),
        answer(1)[:-1],
        longer[:-1],
        longer[:-1] + b"\x55",
        answer(1, unit=2),
        answer(1, function=3),
        sealed(bytes((UNIT, INPUT | 0x80, 2))),
        *(request(register).frame for register in range(0x0300, 0x0400)),  # echoes
    ):
        assert not holds_another_length(heard, request(0))


def test_two_answers_are_none() -> None:
    with pytest.raises(DoubtError, match="more than one"):
        find_answer(answer(1) + answer(2), request(0))
    assert find_answer(answer(1) + answer(1), request(0)) == (answer(1), 7)
    assert find_answer(b"\xff\0" + answer(1) + b"\0", request(0)) == (answer(1), 9)


@dataclass
class Device:
    """A device behind a converter: it works off requests in order, and something goes wrong."""

    line: SerialLine
    #: For each request: what becomes of it, and for how many seconds the device stands still.
    happens: deque[tuple[str, float]]
    #: What it answers by functions that it does not know: an exception, nothing, or values.
    to_others: str
    free_at: float = 0.0
    sent: list[str] = field(default_factory=list)

    def take(self, frame: bytes) -> None:
        loop = asyncio.get_running_loop()
        unit, function, register, _ = struct.unpack(">BBHH", frame[:6])
        what, stands_s = self.happens.popleft() if self.happens else ("answer", 0.0)
        self.sent.append(what)
        self.free_at = max(self.free_at, loop.time()) + stands_s + 0.02
        reply = answer(value_of(register), unit, function)
        if function != INPUT:
            refusal = sealed(bytes((unit, function | 0x80, 1)))
            reply = {"exception": refusal, "nothing": b"", "values": reply}[self.to_others]
        chunks: list[bytes] = {
            "answer": [reply],
            "echo": [frame, reply],
            "merged echo": [frame + reply],
            "cut": [reply[:4]],
            "in pieces": [reply[:3], reply[3:]],
            "twice": [reply, reply],
            "merged twice": [reply + reply],
            "spoilt": [reply[:4] + b"\x55" + reply[5:]],
            "lost": [],
            "stranger's request": [request(register ^ 3).frame, reply],
            "stranger's exchange": [request(900).frame + answer(value_of(900)), reply],
            "other unit": [answer(value_of(901), unit=2) + reply],
            "other length": [sealed(struct.pack(">BBBHH", unit, function, 4, 900, 901))],
            "noise": [b"\xff\x00" + reply + b"\x00"],
        }[what]
        for number, chunk in enumerate(chunks):
            if chunk:
                loop.call_at(self.free_at + 0.001 * number, self.line.hear, chunk)


happenings = st.tuples(
    st.sampled_from(
        [
            "answer", "echo", "merged echo", "cut", "in pieces", "twice", "merged twice", "spoilt",
            "lost", "stranger's request", "stranger's exchange", "other unit", "other length",
            "noise",
        ]
    ),
    st.one_of(st.just(0.0), st.floats(0.0, 6.0)),
)  # fmt: skip


@hypothesis.settings(max_examples=500)
@given(
    st.lists(happenings, max_size=12),
    st.lists(st.tuples(st.integers(0, 5), st.floats(0.0, 2.0)), min_size=1, max_size=25),
    st.sampled_from(["exception", "values", "nothing"]),
)
def test_no_register_ever_has_another_ones_value(
    happens: list[tuple[str, float]], reads: list[tuple[int, float]], to_others: str
) -> None:
    """Answers that come late, twice, cut, echoed and between those of strangers, in any order."""

    async def read_all() -> int:
        line = SerialLine(TIMEOUT_S, 0.002)
        # Of a unit that says nothing to what it does not know, answers may be so late and no later.
        last_s = 2.5 if to_others == "nothing" else 6.0
        held = deque((what, min(stands_s, last_s)) for what, stands_s in happens)
        device = Device(line, deque(), to_others)
        for _ in range(2):  # the unit is known
            await line.exchange(request(0), device.take)
        device.happens = held
        good = 0
        for register, pause_s in [*reads, *[(1, 30.0)] * 3]:
            asked = request(register)
            await asyncio.sleep(pause_s)
            try:
                found = await line.exchange(asked, device.take)
            except (SilenceError, DoubtError):
                continue
            assert found == answer(value_of(register)), device.sent
            good += 1
        return good

    with asyncio.Runner(loop_factory=JumpingLoop) as runner:
        good = runner.run(read_all())
    if len(happens) <= len(reads):
        assert good >= 1, "a line that is well again is read again"
