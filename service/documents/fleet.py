"""Summary of the fleet: what needs attention first, and the state of every asset."""

from typing import Final, Literal

from pydantic import Field

from service.documents.base import Document, Number, Page, Time
from service.documents.limits import Limit
from service.documents.verdicts import Word

FleetState = Literal["over", "ahead", "lost", "unknown", "safe", "waiting", "unread"]
STATES: Final[tuple[FleetState, ...]] = (
    "over",
    "ahead",
    "lost",
    "unknown",
    "safe",
    "waiting",
    "unread",
)
Attention = Literal[
    "alarm", "over", "ahead", "lost", "unknown", "not trusted", "not identified", "drifted"
]
ATTENTIONS: Final[tuple[Attention, ...]] = (
    "alarm",
    "over",
    "ahead",
    "lost",
    "unknown",
    "not trusted",
    "not identified",
    "drifted",
)
"""The most urgent first."""

_STATE = (
    "`over` a limit, limit `ahead`, data `lost`, `unknown` for another reason, `safe`, `waiting` "
    "for the first data, `unread`: not heard of lately."
)
_ATTENTION = (
    "Why it needs attention, the most urgent reason: an unacknowledged `alarm`, `over` a limit, "
    "limit `ahead`, data `lost`, verdict `unknown`, model `not trusted`, `not identified` or "
    "`drifted`. Null: it needs none."
)
MARKS: Final = (
    "One character for each asset, in the order of their ids: `a` over an alarm limit, `b` over a "
    "warning limit, `c` recovering, `d` alarm limit ahead, `e` warning limit ahead, `f` data lost, "
    "`g` unknown, `h` safe now and in the next step, `i` safe now, but the next step is not, or is "
    "unknown, or its model is not trusted, not identified or drifted, `j` waiting for the first "
    "data, `k` unread. A capital: an alarm waits for an acknowledgement."
)


class FleetAlarm(Document):
    """The most urgent alarm of an asset that waits for an acknowledgement."""

    id: str
    kind: str = Field(examples=["measured limit"])
    priority: int = Field(ge=1, le=3)
    predicted: bool
    message: str = Field(examples=["Inner ring over alarm 105 °C"])
    since: Time


class FleetAsset(Document):
    """Summary of one asset."""

    id: str = Field(examples=["bench-1"])
    name: str = Field(description="Name on the pages.", examples=["Test bench 1"])
    group: str | None = Field(description="Null without one.", examples=["Line A"])
    family: str | None = Field(
        description="Machines of one type; null without one.", examples=["6016 grease-L front"]
    )
    bearing: str | None = Field(
        description="Null for a machine with a custom network.", examples=["6311"]
    )
    network: str = Field(examples=["bearing-14"])
    state: FleetState = Field(description=_STATE)
    attention: Attention | None = Field(description=_ATTENTION)
    now: Word = Field(description="The verdict on this moment.")
    next_step: Word = Field(description="The verdict on the next step.")
    reason: str = Field(description="What the state or the attention comes from.")
    missing: list[str] = Field(description="Inputs that the verdict lacks.")
    limit: Limit | None = Field(description="The limit that is exceeded or ahead.")
    seconds_to_limit: Number = Field(
        description="Process seconds until the limit ahead is exceeded at the earliest."
    )
    probability: Number = Field(description="That the limit ahead is exceeded.")
    channel: str | None = Field(description="The temperature of `value_c`.")
    value_c: Number = Field(description="Its last value, °C.")
    value_at: Time | None = Field(description="When it was measured.")
    unacknowledged: int = Field(description="Alarms that wait for an acknowledgement.")
    alarm: FleetAlarm | None = Field(description="The most urgent of them.")
    model_version: int
    trusted: bool
    identified: bool
    drifted: bool = Field(description="The drift report of the active model says: changed.")


class FleetPage(Page):
    """Assets in the wanted order, with figures of all that fit."""

    items: list[FleetAsset]
    total: int = Field(description="Assets of the service.")
    found: int = Field(description="Assets that fit, on all pages.")
    counts: dict[FleetState, int] = Field(
        description="By state, of the assets that fit but for `state` and `attention`."
    )
    attention: int = Field(description="Of these, how many need attention.")
    unacknowledged: int = Field(
        description="Their alarms that wait for an acknowledgement; one that several assets have "
        "counts with each of them."
    )
    age_s: float = Field(
        description="Wall seconds since the cell was asked about the asset that was asked about "
        "longest ago, but for those that are `unread`."
    )
    revision: str = Field(description="Changes with the assets and their configuration.")


class FleetMap(Document):
    """The state of every asset in one short text."""

    revision: str = Field(description="As in `GET /fleet`: which assets are meant.")
    marks: str = Field(description=MARKS, examples=["hhhBhfj"])
