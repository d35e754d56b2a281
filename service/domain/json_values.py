"""What JSON can hold, as a type that publishes what it is."""

from typing import Annotated

from pydantic import Field
from typing_extensions import TypeAliasType

Json = TypeAliasType(
    "Json",
    "bool | int | Annotated[float, Field(allow_inf_nan=False)] | str | list[Json] "
    "| dict[str, Json] | None",
)
"""Any JSON value without infinities."""
