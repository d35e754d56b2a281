"""What a check of a configuration found."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Self

from pydantic import Field

from service.documents.base import Document, Number
from service.domain.channels import unit_of

if TYPE_CHECKING:  # the drivers' libraries are loaded where sources are read
    from service.ingest.probing import Probe


class CheckedSource(Document):
    """How a source answered; `detail` is "ok" or says what is wrong."""

    name: str
    driver: str
    up: bool
    detail: str


class CheckedChannel(Document):
    """The value of a channel, read once."""

    asset: str
    channel: str
    source: str
    value: Number
    unit: str
    quality: int | None = Field(description="OPC DA byte; null where no sample came.")
    age_s: Number
    detail: str = Field(description="Why the value is not good; else empty.")


class CheckedPlan(Document):
    """The planned profile of a controller; `steps` is null when it was not read."""

    asset: str
    source: str
    steps: int | None


class CheckDocument(Document):
    """What `bearing-twin check` says of a configuration."""

    file: str | None
    ok: bool
    errors: list[str] = Field(description="Each names the key, its value and what was expected.")
    warnings: list[str]
    sources: list[CheckedSource]
    channels: list[CheckedChannel]
    plans: list[CheckedPlan]

    @classmethod
    def of(
        cls, file: str | None, errors: Sequence[str], warnings: Sequence[str], probed: "Probe"
    ) -> Self:
        """Show what was found."""
        return cls(
            file=file,
            ok=not errors,
            errors=list(errors),
            warnings=list(warnings),
            sources=[
                CheckedSource(name=one.name, driver=one.driver, up=one.up, detail=one.detail)
                for one in probed.sources
            ],
            channels=[
                CheckedChannel(
                    asset=one.asset,
                    channel=one.channel,
                    source=one.source,
                    value=one.value,
                    unit=unit_of(one.channel),
                    quality=one.quality,
                    age_s=one.age_s,
                    detail=one.detail,
                )
                for one in probed.channels
            ],
            plans=[
                CheckedPlan(asset=one.asset, source=one.source, steps=one.steps)
                for one in probed.plans
            ],
        )
