"""The calls that an engineer makes, from a run to a forecast."""

import time
from collections.abc import Iterator, Sequence
from datetime import datetime
from typing import Any, Literal, Self, TypeVar
from urllib.parse import quote

import httpx2
from pydantic import BaseModel

from bearing_twin_client.documents import (
    AdviceDocument,
    AlarmDocument,
    AlarmList,
    AssetDocument,
    AssetList,
    EnvelopeDocument,
    ForecastRequest,
    IdentificationRequest,
    JobDocument,
    LiveForecast,
    Measurements,
    ModelDocument,
    ModelList,
    ProfileStep,
    Snapshot,
    State,
    TimeWindow,
    VerdictDocument,
    WhatIfAnswer,
    WindowDocument,
    WindowList,
)
from bearing_twin_client.problem import ProblemError
from bearing_twin_client.rows import Row

ENDED = ("succeeded", "failed", "cancelled")
SHORTEST_PAUSE_S = 0.1

Document = TypeVar("Document", bound=BaseModel)
Page = TypeVar("Page", Measurements, ModelList)


class Client:
    """A connection to one service. Use it in a ``with`` block, or close it.

    Each call raises ``ProblemError`` where the service refuses, and ``httpx2.TransportError`` where
    it cannot be reached. Times must have an offset (``datetime.now(UTC)``). `url` is that of the
    service's page: ``http://127.0.0.1:8080``. The `key` of a viewer reads, of an operator forecasts
    too; identifications, models and advice need an engineer's. Within `timeout_s` a question that
    the service is too busy for (503) is asked again.
    """

    def __init__(self, url: str, key: str, timeout_s: float = 60.0) -> None:
        self._timeout_s = timeout_s
        self._http = httpx2.Client(
            base_url=f"{url.rstrip('/')}/api/v1", headers={"X-API-Key": key}, timeout=timeout_s
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the connections."""
        self._http.close()

    # -- the machine now

    def assets(self) -> list[AssetDocument]:
        """All assets that the key may see."""
        return self._get(AssetList, "/assets").items

    def asset(self, asset: str) -> AssetDocument:
        """Configuration, health and active model of an asset."""
        return self._get(AssetDocument, _path(asset))

    def snapshot(self, asset: str) -> Snapshot:
        """Flat tags with quality and time: measured, estimated, forecast maxima, alarms."""
        return self._get(Snapshot, _path(asset, "snapshot"))

    def state(self, asset: str) -> State:
        """The node temperatures as the twin sees them now."""
        return self._get(State, _path(asset, "state"))

    def verdict(self, asset: str) -> VerdictDocument:
        """Whether the machine is safe now, and whether its next step is."""
        return self._get(VerdictDocument, _path(asset, "verdict"))

    def alarms(self, asset: str | None = None) -> list[AlarmDocument]:
        """Alarms of an asset, or of all."""
        return self._get(AlarmList, "/alarms", asset=asset).items

    # -- what was

    def measurements(
        self,
        asset: str,
        channels: Sequence[str] | None = None,
        start: datetime | None = None,
        end: datetime | None = None,
        resolution: Literal["raw", "1s", "1min", "1h", "auto"] = "raw",
    ) -> Iterator[Row]:
        """History with quality, ascending by time, then by channel; page after page.

        `channels`: 50 at most; None: all. `start`, `end`: process times, ``end`` excluded; None:
        one hour before the end, and now. `resolution`: raw samples, or buckets with the mean,
        minimum and maximum of the good ones.
        """
        query = {
            "channel": None if channels is None else list(channels),
            "start": None if start is None else start.isoformat(),
            "end": None if end is None else end.isoformat(),
            "resolution": resolution,
        }
        for page in self._pages(Measurements, _path(asset, "measurements"), **query):
            yield from page.items

    # -- what will be

    def forecast(self, asset: str) -> LiveForecast:
        """Forecast that the twin makes by itself: of the plan, else of the present point held."""
        return self._get(LiveForecast, _path(asset, "forecast"))

    def what_if(
        self,
        asset: str,
        profile: Sequence[ProfileStep],
        step_s: float | None = None,
        nodes: Sequence[str] | None = None,
        keep: bool = False,
    ) -> WhatIfAnswer:
        """Forecast a profile, 48 h at most in all, from the present state of the twin.

        `step_s` is the spacing of the answer; `nodes`: None for all. With `keep` it is kept, and
        scored if the machine does this from now on.
        """
        request = ForecastRequest(
            profile=list(profile),
            step_s=step_s,
            nodes=None if nodes is None else list(nodes),
            keep=keep,
        )
        return self._post(WhatIfAnswer, _path(asset, "forecasts"), request)

    def envelope(self, asset: str) -> EnvelopeDocument:
        """Steady temperatures and times to the limits over speed and load."""
        return self._get(EnvelopeDocument, _path(asset, "envelope"))

    def advice(
        self,
        asset: str,
        speed_rpm: float,
        load_n: float,
        duration_s: float = 7200.0,
        half_width_k: float | None = None,
    ) -> AdviceDocument:
        """Which low-risk step to run next to know more about a point (rpm, N) held so long (s).

        None is proposed once its forecast is known to ± `half_width_k`.
        """
        query = {
            "speed_rpm": speed_rpm,
            "load_n": load_n,
            "duration_s": duration_s,
            "half_width_k": half_width_k,
        }
        return self._get(AdviceDocument, _path(asset, "advice"), **query)

    # -- identification and models

    def windows(self, asset: str) -> list[WindowDocument]:
        """Low-risk windows that an identification takes its data from by itself."""
        return self._get(WindowList, _path(asset, "windows")).items

    def identify(
        self,
        asset: str,
        windows: Sequence[TimeWindow] | None = None,
        method: Literal["noa+refine", "refine", "noa"] = "noa+refine",
        seed: int = 0,
        budget: int | None = None,
    ) -> JobDocument:
        """Start an identification; ``wait`` for the job that this gives.

        `windows`: spans of time to identify from; None: those of ``windows()``. `budget`: most
        evaluations; None: the method's own. With a job under way already ``ProblemError`` 409,
        ``problem.job`` shows it.
        """
        request = IdentificationRequest(
            windows="auto" if windows is None else list(windows),
            method=method,
            seed=seed,
            budget=budget,
        )
        return self._post(JobDocument, _path(asset, "identifications"), request)

    def job(self, asset: str, job_id: str) -> JobDocument:
        """One identification with its phase, progress and convergence."""
        return self._get(JobDocument, _path(asset, "identifications", job_id))

    def wait(
        self, asset: str, job_id: str, timeout_s: float = 3600.0, every_s: float = 1.0
    ) -> JobDocument:
        """Wait until an identification has ``succeeded``, ``failed`` or is ``cancelled``.

        Of it came ``model_version``, or ``error`` says why not. Raises ``TimeoutError`` if it has
        not ended in time; it goes on.
        """
        deadline = time.monotonic() + timeout_s
        while (job := self.job(asset, job_id)).status not in ENDED:
            if time.monotonic() >= deadline:
                raise TimeoutError(f"identification {job_id} is {job.status} after {timeout_s:g} s")
            time.sleep(every_s)
        return job

    def models(self, asset: str) -> Iterator[ModelDocument]:
        """All model versions, newest first; page after page."""
        for page in self._pages(ModelList, _path(asset, "models")):
            yield from page.items

    def model(self, asset: str, version: int) -> ModelDocument:
        """One version with its parameters, the data it comes from and its scores."""
        return self._get(ModelDocument, _path(asset, "models", str(version)))

    # -- how calls are made

    def _get(self, kind: type[Document], path: str, **query: Any) -> Document:
        given = {name: value for name, value in query.items() if value is not None}
        deadline = time.monotonic() + self._timeout_s
        while True:
            answer = self._http.get(path, params=given)
            pause_s = _retry_after_s(answer)
            if pause_s is None or time.monotonic() + pause_s > deadline:
                return _document(kind, answer)
            time.sleep(pause_s)

    def _pages(self, kind: type[Page], path: str, **query: Any) -> Iterator[Page]:
        cursor: str | None = None
        while True:
            page = self._get(kind, path, cursor=cursor, **query)
            yield page
            cursor = page.next
            if cursor is None:
                return

    def _post(self, kind: type[Document], path: str, body: BaseModel) -> Document:
        return _document(
            kind, self._http.post(path, json=body.model_dump(mode="json", exclude_none=True))
        )


def _path(asset: str, *parts: str) -> str:
    """Address below the asset; a name with a slash in it stays one name."""
    return "/".join(["/assets", *(quote(part, safe="") for part in (asset, *parts))])


def _retry_after_s(answer: httpx2.Response) -> float | None:
    """Seconds after which a service that is busy wants to be asked again; else None."""
    text = answer.headers.get("Retry-After", "")
    busy = answer.status_code == httpx2.codes.SERVICE_UNAVAILABLE
    return max(float(text), SHORTEST_PAUSE_S) if busy and text.isdecimal() else None


def _document(kind: type[Document], answer: httpx2.Response) -> Document:
    if not answer.is_success:
        raise ProblemError(answer)
    return kind.model_validate_json(answer.content)
