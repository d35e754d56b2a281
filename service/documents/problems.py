"""Errors as problem documents (RFC 9457)."""

from pydantic import ConfigDict, Field

from service.documents.base import Document, is_none
from service.documents.identification import JobDocument


class FieldError(Document):
    """One thing that is wrong: where, and what was expected."""

    pointer: str | None = Field(None, exclude_if=is_none, description="JSON pointer into the body.")
    parameter: str | None = Field(
        None, exclude_if=is_none, description="Name of the query, path or header parameter."
    )
    detail: str


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
    detail: str
    instance: str
    errors: list[FieldError] = Field(default_factory=list)
    job: JobDocument | None = Field(
        None, exclude_if=is_none, description="The job in the way, of a conflict with one (409)."
    )
