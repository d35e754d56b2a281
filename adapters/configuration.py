"""Common ground of the drivers' configuration models."""

from collections.abc import Iterable
from difflib import get_close_matches
from typing import Any, LiteralString, Self

from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    ModelWrapValidatorHandler,
    ValidationError,
    field_validator,
    model_validator,
)
from pydantic_core import InitErrorDetails, PydanticCustomError

from adapters import AdapterError
from adapters.words import shown


class ConfigurationError(AdapterError, ValueError):
    """A setting that the user can mend; the message is one line that names key and value."""


class StrictModel(BaseModel):
    """A frozen model that refuses unknown keys and says which ones there are."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    @model_validator(mode="wrap")
    @classmethod
    def _refuse_unknown_keys(cls, data: Any, validate: ModelWrapValidatorHandler[Self]) -> Self:
        if not isinstance(data, dict) or cls.model_config.get("extra") != "forbid":
            return validate(data)
        known = [field.alias or name for name, field in cls.model_fields.items()]
        wrong = [
            _error("unknown_key", f"unknown key {shown(key)}; {suggestion(key, known)}", (), data)
            for key in data
            if key not in known
        ]
        if not wrong:
            return validate(data)
        # All that is wrong at once: the other keys are checked as well.
        try:
            validate({key: value for key, value in data.items() if key in known})
        except ValidationError as error:
            wrong += [
                _error(one["type"], one["msg"], one["loc"], one["input"]) for one in error.errors()
            ]
        raise ValidationError.from_exception_data(cls.__name__, wrong)


def _error(
    kind: LiteralString, text: str, place: tuple[int | str, ...], given: Any
) -> InitErrorDetails:
    error = PydanticCustomError(kind, "{text}", {"text": text})
    return InitErrorDetails(type=error, loc=place, input=given)


def suggestion(wrong: str, known: Iterable[str]) -> str:
    """Say what a misspelt name may have meant, or which names there are."""
    names = sorted(known)
    close = get_close_matches(str(wrong), names, n=3, cutoff=0.6)
    if close:
        return "did you mean " + " or ".join(repr(name) for name in close) + "?"
    return f"expected one of {listed(names)}" if names else "there are none"


def listed(names: Iterable[str], most: int = 20) -> str:
    """List names for a message; of thousands the first ones."""
    every = list(names)
    more = f" and {len(every) - most} more" if len(every) > most else ""
    return ", ".join(every[:most]) + more


def first_repeated(names: Iterable[str]) -> str | None:
    """Give the first name that was there before, or None; in one walk, however many there are."""
    known: set[str] = set()
    for name in names:
        if name in known:
            return name
        known.add(name)
    return None


def ascending(limits: tuple[float, float] | None) -> tuple[float, float] | None:
    """Return the limits when the first is below the second, else raise ValueError."""
    if limits is not None and not limits[0] < limits[1]:
        raise ValueError(f"expected [low, high] with low < high, got {list(limits)}")
    return limits


class SourceConfig(StrictModel):
    """What every source says of itself, whatever its driver.

    A driver's model derives from it, narrows `driver` to its own names, and says in place of the
    properties below what it knows better.
    """

    name: str = Field(min_length=1)
    driver: str

    @property
    def expected_period_s(self) -> float | None:
        """Process seconds from one value of a channel to the next; None: only observation shows."""
        return None

    @property
    def first_max_age_s(self) -> float:
        """Age limit of a channel, in process seconds, until its period has been observed."""
        return 120.0

    @property
    def least_max_age_s(self) -> float:
        """Least age limit, in process seconds, that an observed period may lead to."""
        return 10.0

    @property
    def speed_up(self) -> float:
        """How much faster than they happened its values come."""
        return 1.0


class MeasuredChannel(StrictModel):
    """What every channel may say of the values that are to be believed, in the channel's unit.

    `max_jump`, `max_rate_per_s` and `flat_line_s` may be 0 (no such check); without them a channel
    has the defaults of its kind. `max_age_s`, `max_rate_per_s` and `flat_line_s` are process time.
    """

    source: str
    valid_range: tuple[float, float] | None = None
    max_age_s: float | None = Field(default=None, gt=0.0)
    max_jump: float | None = Field(default=None, ge=0.0)
    max_rate_per_s: float | None = Field(default=None, ge=0.0)
    flat_line_s: float | None = Field(default=None, ge=0.0)

    @property
    def expected_period_s(self) -> float | None:
        """Process seconds from one value to the next; None: as the source says."""
        return None

    @property
    def resolution(self) -> float:
        """Least step between two values, in the channel's unit; 0 where none is known."""
        return 0.0

    @field_validator("valid_range")
    @classmethod
    def _range_ascends(cls, limits: tuple[float, float] | None) -> tuple[float, float] | None:
        return ascending(limits)
