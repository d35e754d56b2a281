"""What all documents have in common."""

from collections.abc import Mapping
from typing import Annotated, Any, Self

from pydantic import BaseModel, ConfigDict, Field, WithJsonSchema, model_validator
from pydantic_core import to_json

from service.clock import rfc3339

Time = Annotated[
    str,
    WithJsonSchema(
        {"type": "string", "format": "date-time", "examples": ["2026-11-21T08:00:00.000Z"]}
    ),
]
"""RFC 3339, UTC, process time unless the field says otherwise."""

Number = float | None
"""Null where the value is not known, or not finite."""

Quality = Annotated[
    int,
    Field(
        ge=0,
        le=255,
        description="OPC DA byte: below 64 bad, 64 to 191 uncertain, 192 and above good.",
        examples=[192],
    ),
]


def is_none(value: object) -> bool:
    """Whether a field has nothing to show; such a field is left out of the answer."""
    return value is None


class Document(BaseModel):
    """A part of an answer: described fields and no others."""

    model_config = ConfigDict(extra="forbid", validate_by_name=True, serialize_by_alias=True)

    def to_bytes(self) -> bytes:
        """JSON text; NaN and infinities become null."""
        return to_json(self, inf_nan_mode="null")


class StoredDocument(Document):
    """A document that is read from the store; keys that a newer or older release wrote are left."""

    @model_validator(mode="before")
    @classmethod
    def _known_keys(cls, stored: Any) -> Any:
        if not isinstance(stored, Mapping):
            return stored
        return {name: value for name, value in stored.items() if name in cls.model_fields}

    @classmethod
    def read(cls, stored: Mapping[str, object] | None) -> Self | None:
        """Read a stored part; None where a release did not write it."""
        return None if stored is None else cls.model_validate(stored)


class Page(Document):
    """What every listing has: `next` is the cursor of the next page, null on the last."""

    model_config = ConfigDict(json_schema_serialization_defaults_required=True)

    next: str | None = Field(None, description="Cursor of the next page; null on the last one.")


def time_or_none(time_us: int | None) -> str | None:
    """RFC 3339 of UTC microseconds, None where there is no time."""
    return None if time_us is None else rfc3339(time_us)
