"""The assets as other processes see them: copies of the cell's documents, with their age."""

import asyncio
import hashlib
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, TypeVar, TypeVarTuple

from pydantic_core import from_json, to_json

from adapters.configuration import listed
from adapters.samples import Quality, is_good
from service.bus.calls import call
from service.bus.commands import Assets, PackedDocument, Wanted
from service.bus.interface import ReaderBus
from service.bus.questions import Questions, how_answered
from service.documents.assets import AssetDocument, State
from service.documents.base import Document as Shown
from service.documents.fleet import FleetAsset
from service.documents.forecasts import LiveForecast
from service.documents.interfaces import DocumentKind
from service.documents.machine import AssetFacts, PresentMachine
from service.documents.tags import Snapshot, Tag
from service.documents.verdicts import VerdictDocument, VerdictOf, VerdictOfPresentStep
from service.domain.errors import CellUnavailableError, NotReadyError

Arguments = TypeVarTuple("Arguments")
AnswerT = TypeVar("AnswerT")
#: A copy is given as it is for so many wall seconds; the cell makes a snapshot as often.
FRESH_S: Final = 0.1
#: For so long it is given at once, and the next one is asked for meanwhile.
SOON_S: Final = 0.3
#: Wall seconds that who asks waits for the cell; then the copy that is there must do.
PATIENCE_S: Final = 1.0
#: A copy that is older says nothing for certain any more.
UNCERTAIN_AFTER_S: Final = 5.0
#: Tags with these names are a verdict: 0 is unknown.
_VERDICT_TAG = "verdict."
_UNKNOWN_CODE = 0


@dataclass(slots=True)
class _Copy:
    """A document, when it was known to be right, and what is under way about it."""

    tag: bytes = b""
    text: bytes = b""
    right_s: float = -1e9
    data: Any = None
    asking: "asyncio.Task[None] | None" = None
    asked_s: float = -1e9

    @property
    def age_s(self) -> float:
        return time.monotonic() - self.right_s


def digest(text: bytes) -> bytes:
    """Tag of a document: changes with it."""
    return hashlib.blake2b(text, digest_size=12).digest()


class AssetReplica:
    """One asset of the cell as callers see it. The synchronous methods answer from memory.

    Parameters
    ----------
    id : str
        The asset.
    reader : ReaderBus
        Where its documents come from.
    questions : Questions, optional
        Computes what callers ask; only the web side has it.
    fresh_s : float
        Wall seconds for which a copy is given without asking.
    """

    def __init__(
        self,
        id: str,
        reader: ReaderBus,
        questions: Questions | None = None,
        fresh_s: float = FRESH_S,
    ) -> None:
        self.id = id
        self._reader = reader
        self._questions = questions
        self._fresh_s = fresh_s
        self._copies: dict[DocumentKind, _Copy] = {}
        self._doubtful: tuple[Snapshot | None, Snapshot] = (None, {"tags": {}})
        self._changed_s = -1e9

    # ------------------------------------------------------------------ copies
    def changed(self) -> None:
        """Take no copy from before this moment for fresh: a caller has changed something.

        A client that activates a model, acknowledges an alarm or pushes a sample sees it in its
        next answer.
        """
        self._changed_s = time.monotonic()

    @property
    def changed_s(self) -> float:
        """Wall time, monotonic, since which no caller has changed anything."""
        return self._changed_s

    def is_due(self, kind: DocumentKind, fresh_s: float | None = None) -> bool:
        """Return whether a copy is to be asked for again; ``fresh_s`` says what fresh is here."""
        copy = self._copies.setdefault(kind, _Copy())
        fresh_s = self._fresh_s if fresh_s is None else fresh_s
        return copy.age_s > fresh_s or copy.right_s <= self._changed_s

    async def refresh(self, *kinds: DocumentKind) -> None:
        """Bring copies up to date; where the cell does not answer the old ones stay.

        Callers at the same time wait for one answer together.

        Raises
        ------
        CellUnavailableError
            If there is no copy at all.
        """
        due = []
        for kind in kinds:
            copy = self._copies.setdefault(kind, _Copy())
            if not self.is_due(kind):
                continue
            outdated = copy.right_s <= self._changed_s
            if copy.asking is None or copy.asked_s <= self._changed_s:
                copy.asked_s = time.monotonic()
                copy.asking = asyncio.create_task(self._ask(kind, copy, copy.asked_s))
                # Also where no caller waits for it.
                copy.asking.add_done_callback(lambda done: done.cancelled() or done.exception())
            if outdated or copy.age_s > max(SOON_S, self._fresh_s) or not self._fresh_s:
                due.append(copy.asking)
        for asking in due:
            await asyncio.shield(asking)
        for kind in kinds:
            if not self._copies[kind].text:
                raise CellUnavailableError("the cell has not answered yet")

    async def _ask(self, kind: DocumentKind, copy: _Copy, asked_s: float) -> None:
        try:
            wanted = Wanted(self.id, kind, copy.tag)
            (document,) = await self._reader.ask(call(Assets.documents, [wanted]), PATIENCE_S)
            self.take(kind, document, asked_s)
        except CellUnavailableError:
            pass  # the copy that is there gets older, and says so
        finally:
            if copy.asking is asyncio.current_task():
                copy.asking = None

    def is_known(self, kind: DocumentKind) -> bool:
        """Whether there is a copy."""
        copy = self._copies.get(kind)
        return copy is not None and bool(copy.text)

    def known_tag(self, kind: DocumentKind) -> bytes:
        """Tag of the copy that is there; empty where there is none."""
        return self._copies.setdefault(kind, _Copy()).tag

    def take(self, kind: DocumentKind, document: PackedDocument, asked_s: float) -> None:
        """Take what the cell answered to a question of this monotonic time."""
        copy = self._copies.setdefault(kind, _Copy())
        if asked_s < copy.right_s:  # a later question was answered sooner
            return
        if not document.tag:  # the cell has no such asset now: what is known gets old
            return
        if document.text is not None:
            copy.tag, copy.text, copy.data = document.tag, document.text, None
        copy.right_s = asked_s

    def text(self, kind: DocumentKind) -> tuple[bytes, bytes]:
        """A document as JSON text, with its tag; what is old says so itself."""
        copy = self._copies.get(kind)
        if copy is None or not copy.text:
            raise CellUnavailableError("the cell has not answered yet")
        data = None if copy.age_s <= UNCERTAIN_AFTER_S else self._data(kind)
        if data is None or data is copy.data:  # nothing in it gets wrong with its age
            return copy.text, copy.tag
        text = to_json(data, inf_nan_mode="null")
        return text, digest(text)

    def age_s(self, kind: DocumentKind) -> float:
        """Wall seconds since a copy was known to be right."""
        return self._copies.setdefault(kind, _Copy()).age_s

    def _data(self, kind: DocumentKind) -> Any:
        copy = self._copies.get(kind)
        if copy is None or not copy.text:
            raise CellUnavailableError("the cell has not answered yet")
        if copy.data is None:
            copy.data = _read(kind, copy.text)
        if copy.age_s <= UNCERTAIN_AFTER_S:
            return copy.data
        return self._in_doubt(kind, copy)

    def _in_doubt(self, kind: DocumentKind, copy: _Copy) -> Any:
        """A document without what its age has made uncertain: nothing old is called safe."""
        data = copy.data
        why = f"no data of the twin for {copy.age_s:.0f} s"
        if kind == "snapshot":
            if self._doubtful[0] is not data:
                tags = {name: _uncertain(name, tag) for name, tag in data["tags"].items()}
                self._doubtful = data, {"tags": tags}
            return self._doubtful[1]
        if kind == "verdict":
            unknown = VerdictOf(
                word="unknown",
                reasons=[why],
                limit=None,
                probability=None,
                seconds_to_limit=None,
                alarm_probability=None,
            )
            return VerdictDocument(
                time=data.time,
                now=unknown,
                present_step=VerdictOfPresentStep(**dict(unknown), ends_at=None),
                next_step=unknown,
                time_to_limit=None,
                missing=sorted({*data.missing, "twin"}),
            )
        if kind in ("state", "forecast") and data is not None:
            return data.model_copy(update={"missing": sorted({*data.missing, "twin"})})
        if kind == "summary":
            doubtful = {"status": "degraded", "twin_running": False}
            return data.model_copy(update={"health": data.health.model_copy(update=doubtful)})
        return data

    # ------------------------------------------------------------------ what routes ask
    @property
    def running(self) -> bool:
        """True while the live twin is at work."""
        return self._facts().running and self.age_s("facts") <= UNCERTAIN_AFTER_S

    @property
    def channels(self) -> Mapping[str, str]:
        """Every channel of the asset with the name of its source.

        ``push`` for a pushed one, ``twin`` for the stored estimates of the service.
        """
        return self._facts().channels

    @property
    def temperature_names(self) -> Sequence[str]:
        """Sensors and nodes that a forecast can be asked for."""
        return self._facts().temperature_names

    def _facts(self) -> AssetFacts:
        facts: AssetFacts = self._data("facts")
        return facts

    def summary(self) -> AssetDocument:
        """Return configuration, health and active model, as `GET /assets/{id}` shows them."""
        summary: AssetDocument = self._data("summary")
        return summary

    def snapshot(self) -> Snapshot:
        """Return the flat tags; the same object until one of them changes."""
        snapshot: Snapshot = self._data("snapshot")
        return snapshot

    def asset_summary(self) -> FleetAsset:
        """Return what the fleet shows of it, as it was heard last, however long ago."""
        copy = self._copies.setdefault("asset_summary", _Copy())
        return FleetAsset.model_validate_json(copy.text)

    def verdict(self) -> VerdictDocument:
        """Return the verdict, as `GET /assets/{id}/verdict` shows it."""
        verdict: VerdictDocument = self._data("verdict")
        return verdict

    async def compute(
        self, question: Callable[[Any, *Arguments], AnswerT], *arguments: *Arguments
    ) -> AnswerT:
        """Have a worker answer a question, see `service.bus.questions`.

        Raises
        ------
        NotReadyError
            While the twin has no state yet, or it is not known what the machine runs at, for a
            question that needs it.
        """
        if self._questions is None:
            raise RuntimeError("this process computes nothing")
        how = how_answered(question)
        machine = None if how.of_store else await self._machine()
        if machine and machine.missing and how.needs_operation:
            needs = f"{how.needs_operation} needs the present operation"
            raise NotReadyError(f"{needs}; missing: {listed(machine.missing)}")
        return await self._questions.answer(question, self.id, machine, *arguments)

    async def model_version(self) -> int:
        """The model version that answers are computed with.

        Raises
        ------
        NotReadyError
            While the twin has no state yet.
        """
        return (await self._machine()).version

    async def _machine(self) -> PresentMachine:
        """The state that answers begin from: of now, or none."""
        await self.refresh("machine")
        if self.age_s("machine") > UNCERTAIN_AFTER_S:
            raise CellUnavailableError("the cell does not answer")
        machine: PresentMachine = self._data("machine")
        if machine.estimate is None:
            raise NotReadyError("the twin waits for the first good temperatures, speed and load")
        return machine


_MODELS: Final[Mapping[DocumentKind, type[Shown]]] = {
    "summary": AssetDocument,
    "state": State,
    "verdict": VerdictDocument,
    "forecast": LiveForecast,
    "facts": AssetFacts,
    "machine": PresentMachine,
}


def _read(kind: DocumentKind, text: bytes) -> Any:
    """A document of its text; tags as plain JSON types."""
    model = _MODELS.get(kind)
    if model is None or text == b"null":
        return from_json(text)
    return model.model_validate_json(text)


def _uncertain(name: str, tag: Tag) -> Tag:
    if name.startswith(_VERDICT_TAG):
        return {**tag, "value": _UNKNOWN_CODE}
    return {**tag, "quality": int(Quality.LAST_USABLE)} if is_good(tag["quality"]) else tag
