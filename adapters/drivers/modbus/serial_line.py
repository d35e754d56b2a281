"""Requests and answers on a line whose frames have no transaction number: Modbus RTU.

An RTU frame says which unit sends it, by which function and how many bytes, not which request it
answers. Bytes with a right checksum are not yet the answer to the last request: an adapter that
echoes gives back what was sent, another master asks on the same line, a converter that was busy
gives the answers to requests that were given up.
"""

import asyncio
import contextlib
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from pymodbus.framer.rtu import FramerRTU

BIT_FUNCTIONS: Final = (1, 2)
#: Numbers of bits of which the answer looks like a request, by its length and its first bytes.
AMBIGUOUS_BITS: Final = range(17, 25)
Send = Callable[[bytes], object]
_FUNCTIONS = (3, 4, 1, 2)
#: After so many probes without an answer a unit is taken for one that has none for them; and one
#: that has not answered anything yet.
_PROBES_MAX, _PROBES_FIRST = 20, 3
#: So many time-outs without a second answer end a doubt where no probe is answered.
_QUIET = 3
_HEARD_MAX = 4096
_REQUEST_SIZE = 8  # unit, function, address, count, checksum
_EXCEPTION_SIZE = 5  # unit, function with its highest bit, code, checksum
_AROUND_SIZE = 5  # unit, function, number of bytes; checksum
_EXCEPTION = 0x80


class SilenceError(Exception):
    """No answer came in time."""


class OtherLengthError(SilenceError):
    """In time came no answer, but one of another length."""


class DoubtError(Exception):
    """What came may be the answer to another request."""


@dataclass(frozen=True, slots=True)
class Request:
    """A read: its frame, and how many registers or bits it asks for.

    Without a count any answer of its form will do.
    """

    frame: bytes
    count: int | None

    @property
    def form(self) -> bytes:
        """Unit and function: what its answers have in common with those of other requests."""
        return self.frame[:2]

    def by(self, function: int) -> "Request":
        """Give the same read by another function, of one register or bit."""
        address = self.frame[2:4]
        return Request(sealed(bytes((self.frame[0], function)) + address + b"\0\1"), None)

    @property
    def data_size(self) -> int | None:
        """Bytes of values in its answer."""
        if self.count is None:
            return None
        return -(-self.count // 8) if self.form[1] in BIT_FUNCTIONS else 2 * self.count


class SerialLine:
    """One line, over all its connections: what is under way may come after the next one is opened.

    A request that ends without its answer leaves its unit and function *in doubt*: the answer may
    come yet. Units answer in the order in which they are asked. So before the next request of that
    kind the unit is asked by another function, which has other answers, if only the one that it
    does not know that function: then all earlier answers have come, or never will. Of a unit that
    has no word for functions that it does not know, an answer is thrown away that nothing has
    followed for some time-outs.

    - ``timeout_s``: wall seconds for an answer.
    - ``silence_s``: between the last byte that was heard and a request.
    """

    def __init__(self, timeout_s: float, silence_s: float) -> None:
        self._timeout_s, self._silence_s = timeout_s, silence_s
        self._is_lost = False
        self._heard = bytearray()  # since the last request, behind its answer
        self._heard_at = 0.0
        self._more = asyncio.Event()
        self._forms: set[bytes] = set()  # of all requests so far
        self._in_doubt: set[bytes] = set()
        # By which form each one in doubt is cleared up, and how often that was not answered.
        self._probes: dict[bytes, bytes] = {}
        self._unanswered: Counter[int] = Counter()
        # Whether units answer to functions that they do not know; None: they have answered at all.
        self._answers_all: dict[int, bool | None] = {}

    def lose(self) -> None:
        """Note that the connection is gone: no answer comes over it any more."""
        self._is_lost = True
        self._more.set()

    def hear(self, data: bytes) -> None:
        """Take bytes from the line."""
        self._heard += data
        del self._heard[:-_HEARD_MAX]
        self._heard_at = _now()
        self._in_doubt |= {form for form in self._forms if _begins_alike(self._heard, form)}
        self._more.set()

    async def exchange(self, request: Request, send: Send) -> bytes:
        """Send a request and give the frame that answers it.

        Raises `SilenceError` where none came in time, `DoubtError` where what came may be the
        answer to another request, `ConnectionError` where the connection was lost.
        """
        unit = request.form[0]
        if self._answers_all.get(unit, False) is None:
            await self._learn(request, send)
        if request.form in self._in_doubt:
            await self._end_doubt(request, send)
        answer = await self._ask(request, send)
        self._answers_all.setdefault(unit, None)
        return answer

    async def _learn(self, request: Request, send: Send) -> None:
        """Learn whether a unit answers to functions that it does not know."""
        unit, function = request.form
        probe = request.by(next(other for other in _FUNCTIONS if other != function))
        try:
            await self._ask(probe, send)
            self._answers_all[unit] = True
        except (SilenceError, DoubtError):
            self._answers_all[unit] = False

    async def _end_doubt(self, request: Request, send: Send) -> None:
        """Have all answers to earlier requests of this form behind us."""
        form, unit = request.form, request.form[0]
        answers_all = self._answers_all.get(unit)
        probe = None if answers_all is False else self._probe(request)
        most = _PROBES_MAX if answers_all else _PROBES_FIRST
        if probe is not None:
            # Until one of them is answered, nothing of this form is sent.
            self._probes[form] = probe.form
            try:
                await self._ask(probe, send)
            except (SilenceError, DoubtError):
                self._unanswered[unit] += 1
                if self._unanswered[unit] < most:
                    raise
        if probe is None or self._unanswered[unit] >= most:
            self._probes.pop(form, None)
            await self._ask(request, send)
            await self._hear_no_other(request)
        self._unanswered[unit] = 0
        self._probes.pop(form, None)
        self._in_doubt.discard(form)

    def _probe(self, request: Request) -> Request | None:
        """Give the same request by another function of which no answer is under way."""
        used = self._probes.get(request.form)
        if used is not None:
            return request.by(used[1])
        others = (request.by(function) for function in _FUNCTIONS if function != request.form[1])
        return next((one for one in others if one.form not in self._in_doubt), None)

    async def _ask(self, request: Request, send: Send) -> bytes:
        await self._wait_for_silence()
        form = request.form
        was_in_doubt = form in self._in_doubt
        self._heard.clear()
        self._is_lost = False
        self._forms.add(form)
        self._in_doubt.add(form)
        send(request.frame)
        answer, end = await self._find(request)
        del self._heard[:end]
        if not was_in_doubt:
            # It answers in order: what was asked before is over, unless this one comes once more.
            self._in_doubt -= {one for one in self._in_doubt if one[0] == form[0]}
            if _begins_alike(self._heard, form):
                self._in_doubt.add(form)
        return answer

    async def _wait_for_silence(self) -> None:
        give_up_at = _now() + self._timeout_s
        while (left_s := self._heard_at + self._silence_s - _now()) > 0.0:
            if _now() > give_up_at:
                raise SilenceError("the line is never silent")
            await asyncio.sleep(left_s)

    async def _find(self, request: Request) -> tuple[bytes, int]:
        try:
            async with asyncio.timeout(self._timeout_s):
                while True:
                    self._more.clear()
                    found = find_answer(bytes(self._heard), request)
                    if found is not None:
                        return found
                    if self._is_lost:
                        raise ConnectionError("connection lost")
                    await self._more.wait()
        except TimeoutError:
            if holds_another_length(bytes(self._heard), request):
                raise OtherLengthError("an answer of another length came") from None
            raise SilenceError(f"no answer within {self._timeout_s:g} s") from None

    async def _hear_no_other(self, request: Request) -> None:
        """Listen to the line for some time-outs, in which no more answers may come."""
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(_QUIET * self._timeout_s):
                while True:
                    self._more.clear()
                    if _begins_alike(self._heard, request.form):
                        raise DoubtError("answers to earlier requests come")
                    await self._more.wait()


def find_answer(heard: bytes, request: Request) -> tuple[bytes, int] | None:
    """Find the frame that answers a request in what was heard since, and where it ends.

    None: it has not come yet. Raises `DoubtError` where another master asked for the like before,
    or where more than one answer came.
    """
    begin = 0
    while begin < len(heard):
        rest = heard[begin:]
        if rest.startswith(request.frame):  # an echo
            begin += len(request.frame)
            continue
        if request.frame.startswith(rest):
            return None  # an echo that is not whole, perhaps
        size = _answer_size(rest, request)
        if size is not None and _is_sound(rest[:size], size):
            frame, behind = rest[:size], rest[size:]
            if _begins_alike(behind, request.form) and not _repeats(behind, frame):
                raise DoubtError("more than one answer came")
            return frame, begin + size
        if rest[:2] == request.form and _is_sound(rest[:_REQUEST_SIZE], _REQUEST_SIZE):
            if size is not None and len(rest) < size:
                return None  # an answer that is not whole, perhaps
            raise DoubtError("another master asks this unit")
        begin += 1
    return None


def holds_another_length(heard: bytes, request: Request) -> bool:
    """Whether a sound answer of this unit and function was heard that has another length.

    One that is as long as a request may be one, of another master or an echo.
    """
    form = request.form
    for begin in range(len(heard) - _AROUND_SIZE + 1):
        if heard.startswith(form, begin):
            size = _AROUND_SIZE + heard[begin + len(form)]
            is_other = heard[begin + len(form)] != request.data_size and size != _REQUEST_SIZE
            if is_other and _is_sound(heard[begin : begin + size], size):
                return True
    return False


def sealed(body: bytes) -> bytes:
    """Put the checksum behind what a frame says."""
    return body + FramerRTU.compute_CRC(body).to_bytes(2, "big")


def _answer_size(heard: bytes, request: Request) -> int | None:
    """Size of the answer or exception that begins here; None where none does."""
    unit, function = request.form
    if heard[:2] == bytes((unit, function | _EXCEPTION)):
        return _EXCEPTION_SIZE
    if heard[:2] != request.form or len(heard) < _AROUND_SIZE:
        return None
    return _AROUND_SIZE + heard[2] if request.data_size in (None, heard[2]) else None


def _begins_alike(heard: bytes | bytearray, form: bytes) -> bool:
    """Whether an answer of this unit and function begins in what was heard."""
    return form in heard or bytes((form[0], form[1] | _EXCEPTION)) in heard


def _repeats(heard: bytes, frame: bytes) -> bool:
    """Whether something is a frame over and over again, the last time perhaps not whole."""
    return (frame * (len(heard) // len(frame) + 1)).startswith(heard)


def _is_sound(frame: bytes, size: int) -> bool:
    """Whether a frame is whole and ends with the checksum of the rest."""
    return len(frame) == size and FramerRTU.check_CRC(frame[:-2], int.from_bytes(frame[-2:], "big"))


def _now() -> float:
    return asyncio.get_running_loop().time()
