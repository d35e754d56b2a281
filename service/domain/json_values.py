"""What JSON can hold, as a type that publishes what it is."""

from typing import Annotated

from pydantic import BeforeValidator, Field
from typing_extensions import TypeAliasType

from service.domain.upload_limits import small_enough

Json = TypeAliasType(
    "Json",
    "bool | int | Annotated[float, Field(allow_inf_nan=False)] | str | list[Json] "
    "| dict[str, Json] | None",
)
"""Any JSON value without infinities."""

Table = Annotated[dict[str, Json], BeforeValidator(small_enough)]
"""A table of the configuration, no larger than a hand would write it."""
