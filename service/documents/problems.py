"""Errors as problem documents (RFC 9457)."""

from typing import Annotated

from pydantic import BeforeValidator, ConfigDict, Field

from service.documents.base import Document, is_none
from service.documents.identification import JobDocument


def _writable(text: str | None) -> str | None:
    """Show half of a surrogate pair, which callers may send and no answer can hold, as ``?``."""
    return None if text is None else text.encode(errors="replace").decode()


Said = Annotated[str, BeforeValidator(_writable)]
"""A text that may repeat what a caller has sent."""


class FieldError(Document):
    """One thing that is wrong: where, and what was expected."""

    pointer: Said | None = Field(
        None, exclude_if=is_none, description="JSON pointer into the body."
    )
    parameter: Said | None = Field(
        None, exclude_if=is_none, description="Name of the query, path or header parameter."
    )
    detail: Said


class ProblemDocument(Document):
    """An error as RFC 9457 has it."""

    model_config = ConfigDict(
        json_schema_extra={
            "examples": [
                {
                    "type": "about:blank",
                    "title": "Unprocessable Entity",
                    "status": 422,
                    "detail": "profile[0].speed_rpm: Input should be less than or equal to 20000",
                    "instance": "/api/v1/assets/bench-1/forecasts",
                    "errors": [
                        {
                            "pointer": "/profile/0/speed_rpm",
                            "detail": "Input should be less than or equal to 20000 (got 30000)",
                        }
                    ],
                }
            ]
        },
    )

    type: str = "about:blank"
    title: str
    status: int = Field(ge=400, le=599)
    detail: Said
    instance: Said
    errors: list[FieldError] = Field(default_factory=list)
    job: JobDocument | None = Field(
        None, exclude_if=is_none, description="The job in the way, of a conflict with one (409)."
    )
