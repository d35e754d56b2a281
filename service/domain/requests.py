"""What callers ask for: the bodies of requests, checked."""

from typing import Annotated, Any, Literal

from pydantic import (
    BaseModel,
    ConfigDict,
    Discriminator,
    Field,
    Tag,
    ValidationInfo,
    field_validator,
)

from service.domain.channels import NODES, RING_SENSORS
from service.domain.texts import OneLine
from service.domain.times import Instant

MAX_PROFILE_HOURS = 48
MAX_PROFILE_STEPS = 200
MAX_FORECAST_ROWS = 3000
PUSH_SOURCE = "push"


class RequestBody(BaseModel):
    """What all bodies have in common: no unknown members, no conversions, finite numbers."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)

    @field_validator("*", mode="before")
    @classmethod
    def _no_nul(cls, value: Any) -> Any:
        """PostgreSQL keeps no text with the character NUL, and no one types one."""
        if isinstance(value, str) and "\x00" in value:
            raise ValueError("expected a text without the character NUL")
        return value


NodeName = Annotated[
    str,
    Field(
        pattern=r"^t_[a-z0-9_]+_c$",
        max_length=100,
        description=f"{', '.join(RING_SENSORS)}, {NODES[0]} to {NODES[-1]}, or a sensor or node "
        "of the asset's own network.",
        examples=[RING_SENSORS[0]],
    ),
]


class ProfileStep(RequestBody):
    """So long at this speed, radial load and, if given, ambient temperature."""

    duration_s: float = Field(
        gt=0, le=MAX_PROFILE_HOURS * 3600, description="Length of the step in seconds."
    )
    speed_rpm: float = Field(ge=0, le=20_000, description="Speed in revolutions per minute.")
    load_n: float = Field(ge=0, le=200_000, description="Radial load in newtons.")
    ambient_c: float | None = Field(
        None,
        ge=-40,
        le=80,
        description="Ambient temperature in degrees Celsius; absent: as it is now.",
    )


class ForecastRequest(RequestBody):
    """A what-if: the profile to be forecast from the present state of the twin."""

    model_config = ConfigDict(
        json_schema_extra={
            "examples": [
                {
                    "profile": [
                        {"duration_s": 1800, "speed_rpm": 4200, "load_n": 2650},
                        {"duration_s": 3600, "speed_rpm": 6200, "load_n": 5500, "ambient_c": 24},
                    ],
                    "step_s": 60,
                    "nodes": ["t_inner_ring_c", "t_outer_ring_c"],
                }
            ]
        }
    )

    profile: list[ProfileStep] = Field(
        min_length=1,
        max_length=MAX_PROFILE_STEPS,
        description=f"The steps in order, together at most {MAX_PROFILE_HOURS} h.",
    )
    step_s: float | None = Field(
        None,
        gt=0,
        le=3600,
        description=f"Spacing of the answer in seconds, at most {MAX_FORECAST_ROWS} rows.",
    )
    nodes: list[NodeName] | None = Field(
        None, min_length=1, description="Sensors and nodes to be answered; absent: all."
    )
    keep: bool = Field(
        False,
        description="Keep it, and hold it against what comes if the machine does this from now on.",
    )

    @field_validator("profile")
    @classmethod
    def _not_too_long(cls, profile: list[ProfileStep]) -> list[ProfileStep]:
        total_s = sum(step.duration_s for step in profile)
        if total_s > MAX_PROFILE_HOURS * 3600:
            raise ValueError(
                f"the steps last {total_s:g} s together, expected at most "
                f"{MAX_PROFILE_HOURS * 3600} s ({MAX_PROFILE_HOURS} h)"
            )
        return profile

    @field_validator("step_s")
    @classmethod
    def _not_too_many_rows(cls, step_s: float | None, info: ValidationInfo) -> float | None:
        total_s = sum(step.duration_s for step in info.data.get("profile", ()))
        if step_s is not None and total_s / step_s > MAX_FORECAST_ROWS:
            raise ValueError(
                f"{step_s:g} s gives {total_s / step_s:.0f} rows over the profile of "
                f"{total_s:g} s, expected at most {MAX_FORECAST_ROWS}"
            )
        return step_s


class GreaseRenewedRequest(RequestBody):
    """Why the grease was renewed."""

    model_config = ConfigDict(
        json_schema_extra={"examples": [{"comment": "regreased, 18 g of the same grease"}]}
    )

    comment: OneLine | None = Field(None, max_length=500, description="For the journal.")


class TimeWindow(RequestBody):
    """A span of process time, start inclusive and end exclusive."""

    start: Instant
    end: Instant

    @field_validator("end")
    @classmethod
    def _end_is_later(cls, end: int, info: ValidationInfo) -> int:
        if end <= info.data.get("start", end - 1):
            raise ValueError("expected an end later than the start")
        return end


class IdentificationRequest(RequestBody):
    """What to identify from, and how."""

    model_config = ConfigDict(
        json_schema_extra={"examples": [{"windows": "auto", "method": "noa+refine", "seed": 0}]}
    )

    windows: Annotated[
        Annotated[Literal["auto"], Tag("auto")]
        | Annotated[list[TimeWindow], Field(min_length=1, max_length=100), Tag("list")],
        Discriminator(lambda given: "list" if isinstance(given, list) else "auto"),
    ] = Field(
        "auto",
        description="`auto` takes the low-risk windows of the store, else these windows.",
    )
    method: Literal["noa+refine", "refine", "noa"] = "noa+refine"
    seed: int = Field(0, ge=0, le=2**32 - 1, description="Seed of the search.")
    budget: int | None = Field(
        None, ge=100, le=5_000_000, description="Most evaluations; absent: the method's own."
    )
