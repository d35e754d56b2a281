"""Whether the machine is safe now, to the end of its present step, and in its next step."""

from collections.abc import Mapping
from typing import Final, Literal

from pydantic import Field

from service.documents.base import Document, Number, Time
from service.documents.limits import Limit

Word = Literal["safe", "not safe", "recovering", "unknown"]
CODES: Final[Mapping[Word, int]] = {"unknown": 0, "safe": 1, "not safe": 2, "recovering": 3}
"""Values of the tags ``verdict.now``, ``verdict.present_step`` and ``verdict.next_step``."""


class VerdictOf(Document):
    """One word with what stands behind it."""

    word: Word
    reasons: list[str] = Field(
        examples=[["Inner ring over warning 90 °C with 3 % at 6200 rpm, 5500 N"]]
    )
    limit: Limit | None = Field(description="The limit that decides.")
    probability: Number = Field(
        description="That this limit is exceeded; 1 when it is exceeded already.", examples=[0.03]
    )
    seconds_to_limit: Number = Field(
        description="Process seconds until it is exceeded at the earliest (2.5 % of the "
        "forecasts); null when fewer exceed it."
    )
    alarm_probability: Number = Field(
        description="That the alarm limit of the same channel is exceeded."
    )


class VerdictOfPresentStep(VerdictOf):
    """The verdict on the step in hand, and when that step ends."""

    ends_at: Time | None = Field(
        description="When the step ends by the plan; null where nothing is planned."
    )


class TimeToLimit(Document):
    """The limit that is exceeded first along all that is planned.

    Of a channel that is over its warning already it is the alarm limit.
    """

    limit: Limit
    expected: bool = Field(description="Whether the probability is above that of the verdict safe.")
    probability: float = Field(description="That it is exceeded.")
    earliest_s: Number = Field(description="Seconds from now, 2.5 % of the forecasts.")
    median_s: Number = Field(description="Seconds from now, half of the forecasts.")
    horizon_s: float = Field(description="How far the forecast looks, seconds from now.")


class Judgements(Document):
    """The three verdicts, and the inputs that they lack."""

    now: VerdictOf
    present_step: VerdictOfPresentStep = Field(
        description="Of what is left of the present planned step; with none planned, of the "
        "present point, held to the end of the forecast. A step that was called `not safe` stays "
        "so until it has ended or was changed."
    )
    next_step: VerdictOf = Field(
        description="Of the next planned step; with none planned, of the present one to its end."
    )
    time_to_limit: TimeToLimit | None = Field(
        description="Null while an input of `next_step` is missing."
    )
    missing: list[str] = Field(
        description="Inputs that are not there: channels, `twin` (it does not run), `limits`, "
        "`identified model`, `forecast`.",
        examples=[["speed_rpm"]],
    )

    @property
    def by_name(self) -> Mapping[str, VerdictOf]:
        """The three, as their tags are called."""
        return {
            "now": self.now,
            "present_step": self.present_step,
            "next_step": self.next_step,
        }


class VerdictDocument(Judgements):
    """Whether the machine is safe now, to the end of its present step, and in its next step."""

    time: Time
