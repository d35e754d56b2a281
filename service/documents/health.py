"""Whether the service works."""

from typing import Literal

from pydantic import Field

from service.documents.base import Document


class Alive(Document):
    """The process answers."""

    status: Literal["alive"] = Field("alive")


class ReadyCheck(Document):
    """One thing that the service needs."""

    name: str = Field(examples=["source:pt100"])
    status: Literal["ok", "degraded", "failed"]
    detail: str | None = Field(description="Null for a caller without a key.")


class Ready(Document):
    """Whether the service does its work."""

    status: Literal["ready", "degraded", "not ready"]
    checks: list[ReadyCheck]
