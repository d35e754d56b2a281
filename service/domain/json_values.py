"""What JSON can hold, as a type that publishes what it is."""

import json
from typing import Annotated, Any

from pydantic import BeforeValidator, Field
from pydantic_core import from_json
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


def read_json_text(content: bytes) -> Any:
    """Read JSON in any encoding of Unicode; half of a surrogate pair can be written nowhere later.

    Raises `ValueError` where it is none.
    """
    return from_json(content.decode(json.detect_encoding(content)))
