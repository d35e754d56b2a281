"""What people say to alarms."""

from typing import Annotated

from pydantic import ConfigDict, Field

from service.alarms import LONGEST_SHELVING_S
from service.domain.requests import RequestBody
from service.domain.texts import OneLine

MOST_AT_ONCE = 500
_COMMENT = "load is being reduced"

Comment = Annotated[
    OneLine, Field(max_length=500, description="For the journal.", examples=[_COMMENT])
]
MandatoryComment = Annotated[
    OneLine,
    Field(min_length=1, max_length=500, description="For the journal.", examples=[_COMMENT]),
]


class CommentedRequest(RequestBody):
    """An action on an alarm, with a reason if there is one."""

    model_config = ConfigDict(json_schema_extra={"examples": [{"comment": _COMMENT}]})

    comment: Comment | None = None


class CommentRequest(RequestBody):
    """A comment, or an action that must not go without."""

    model_config = ConfigDict(json_schema_extra={"examples": [{"comment": _COMMENT}]})

    comment: MandatoryComment


class ShelveRequest(RequestBody):
    """Shelve an alarm for a while; it comes back automatically."""

    model_config = ConfigDict(
        json_schema_extra={"examples": [{"duration_s": 1800, "comment": "sensor is being changed"}]}
    )

    duration_s: float = Field(
        gt=0,
        le=LONGEST_SHELVING_S,
        description=f"Process seconds, at most {LONGEST_SHELVING_S:g} (8 h).",
    )
    comment: Comment | None = None


class AcknowledgeManyRequest(RequestBody):
    """Several alarms at once, each judged for itself."""

    model_config = ConfigDict(
        json_schema_extra={
            "examples": [{"ids": ["5d0c9a3e7b1f4e2a9c8d7e6f5a4b3c2d"], "comment": _COMMENT}]
        }
    )

    ids: list[Annotated[str, Field(min_length=1, max_length=64)]] = Field(
        min_length=1, max_length=MOST_AT_ONCE
    )
    comment: Comment | None = None
