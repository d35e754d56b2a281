"""A table of the configuration."""

from typing import Any, Self

from pydantic import BaseModel, ConfigDict


class Section(BaseModel):
    """A table of the configuration: no unknown keys, finite numbers, unchangeable."""

    model_config = ConfigDict(
        extra="forbid", frozen=True, allow_inf_nan=False, hide_input_in_errors=True
    )

    def __deepcopy__(self, memo: dict[int, Any] | None = None) -> Self:
        """Give the same: thousands of assets share the defaults, which cannot be changed."""
        return self
