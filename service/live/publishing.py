"""What of one asset is sent to those who follow it, and stored: samples, states, verdicts."""

import asyncio
import math
from collections.abc import Callable, Sequence

from adapters.samples import Quality, Sample
from service.documents.assets import StateMessage
from service.documents.interfaces import LivePublisher
from service.documents.messages import NewSamples
from service.live import presentation
from service.live.asset_documents import AssetDocuments
from service.live.estimate import LiveEstimate
from service.live.forecasting import Forecasting
from service.live.judgement import Judgement

ESTIMATE_EVERY_S = 60.0
STATE_LEAST_WALL_S = 0.5
VERDICT_EVERY_WALL_S = 5.0

Store = Callable[[Sequence[Sample]], object]


class Publishing:
    """Sends what is new of an asset, and stores its estimates.

    - ``store_samples``: takes the twin's own estimates for the store.
    - ``verdict_due``: whether something has changed that the verdict depends on.
    """

    __slots__ = (
        "_asset",
        "_bus",
        "_documents",
        "_judgement",
        "_published_state_wall_s",
        "_published_verdict",
        "_published_wall_s",
        "_store_samples",
        "_stored_us",
        "_unsent",
        "_verdict_at_us",
        "_verdict_holds_us",
        "verdict_due",
    )

    def __init__(
        self,
        asset: str,
        bus: LivePublisher,
        documents: AssetDocuments,
        judgement: Judgement,
        store_samples: Store,
    ) -> None:
        self._asset = asset
        self._bus = bus
        self._documents = documents
        self._judgement = judgement
        self._store_samples = store_samples
        self._unsent: dict[str, Sample] = {}
        self.verdict_due = True
        self._verdict_at_us = 0
        self._verdict_holds_us = -math.inf
        self._published_verdict: object = None
        self._published_wall_s = -math.inf
        self._published_state_wall_s = -math.inf
        self._stored_us = 0

    def take(self, news: Sequence[Sample]) -> None:
        """Take in samples that are news."""
        if self._bus.is_followed(self._asset):
            self._unsent |= {sample.channel: sample for sample in news}
        if self._judgement.is_news(news):
            self.verdict_due = True
        self._documents.changed()

    def clock_set(self) -> None:
        """Send and store again as often as before."""
        self.verdict_due = True
        self._stored_us = 0

    def stepped(self, now_us: int, estimate: LiveEstimate, is_blind: bool) -> None:
        """Send and store what is due of an estimate that has made a step."""
        quality = Quality.LAST_USABLE if is_blind else Quality.GOOD
        if self._bus.is_followed(self._asset):
            wall_s = asyncio.get_running_loop().time()
            if wall_s - self._published_state_wall_s >= STATE_LEAST_WALL_S:
                # With the sensors' estimates, so that a chart needs no polling.
                own = estimate.samples(self._asset, now_us, quality)
                samples = presentation.samples_document(own)
                message = StateMessage(**dict(self._documents.state()), samples=samples)
                self._bus.publish("state", self._asset, message)
                self._published_state_wall_s = wall_s
        if now_us - self._stored_us >= ESTIMATE_EVERY_S * 1e6:
            self._store_samples(estimate.samples(self._asset, now_us, quality))
            self._stored_us = now_us

    def forecast(self, forecasting: Forecasting) -> None:
        """Send a new forecast."""
        self.verdict_due = True
        self._documents.changed()
        latest = forecasting.latest if self._bus.is_followed(self._asset) else None
        if latest is not None:
            self._bus.publish("forecast", self._asset, latest)

    def publish(self, now_us: int, wall_s: float) -> None:
        """Send what is new to those who follow: the latest samples, and the verdict.

        The verdict is sent when it changes, and now and then so that its age can be seen. It is
        made again only when something that it depends on has changed: on a site with hundreds of
        machines hardly anything has.
        """
        if self._unsent:
            samples = presentation.samples_document(self._unsent.values())
            self._unsent = {}
            self._bus.publish("measurement", self._asset, NewSamples(samples=samples))
        old = wall_s - self._published_wall_s >= VERDICT_EVERY_WALL_S and self._bus.is_followed(
            self._asset
        )
        if not (self.verdict_due or old or self._time_changes_it(now_us)):
            return
        self.verdict_due = False
        # Also without a subscriber: the tags show since when its words hold.
        verdict = self._documents.verdict()
        self._note_time(now_us)
        words = [(one.word, one.limit) for one in verdict.by_name.values()]
        news = words, verdict.missing
        if old or news != self._published_verdict:
            self._published_verdict = news
            if self._bus.is_followed(self._asset):
                self._bus.publish("verdict", self._asset, verdict)
                self._published_wall_s = wall_s

    def _time_changes_it(self, now_us: int) -> bool:
        """Whether time alone may give another verdict than the last one.

        When it was to become old, a step of the plan was to end or a channel to be stale, newer
        data may have come meanwhile: then it holds until a later moment.
        """
        if now_us < self._verdict_holds_us:
            return False
        self._verdict_holds_us = self._judgement.holds_until_us(self._verdict_at_us)
        return now_us >= self._verdict_holds_us

    def _note_time(self, now_us: int) -> None:
        self._verdict_at_us = now_us
        self._verdict_holds_us = self._judgement.holds_until_us(now_us)
