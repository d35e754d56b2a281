"""A bearing in the configuration: a designation of the catalogue, or dimensions."""

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any, Self

from pydantic import Field, PositiveFloat, ValidationError, model_validator

from service.domain.section import Section
from service.site.configuration import SettingsError, describe_all, read_toml
from twin_core.bearings import Bearing, bearing, bearing_from_dimensions

_LONGEST_NAME = 64


class BearingSection(Section):
    """A deep groove ball bearing; what is left out is estimated from bore, outside and width."""

    designation: str = Field("", max_length=_LONGEST_NAME)
    bore_mm: PositiveFloat
    outer_mm: PositiveFloat
    width_mm: PositiveFloat
    ball_count: int | None = Field(None, ge=3)
    ball_diameter_mm: PositiveFloat | None = None
    inner_shoulder_mm: PositiveFloat | None = None
    outer_shoulder_mm: PositiveFloat | None = None
    static_load_rating_n: PositiveFloat | None = None
    cage_kg: PositiveFloat | None = None

    @model_validator(mode="after")
    def _make_a_bearing(self) -> Self:
        self.bearing()
        return self

    @property
    def name(self) -> str:
        """The designation, or what the dimensions say: ``40x80x18``."""
        return self.designation.strip() or f"{self.bore_mm:g}x{self.outer_mm:g}x{self.width_mm:g}"

    def bearing(self) -> Bearing:
        """Return the bearing, with estimates of what is not given."""
        given = self.model_dump(exclude={"designation"})
        return bearing_from_dimensions(self.name, **given)


def bearing_table(value: object) -> object:
    """Turn a designation of the catalogue into the bearing's table; leave a table as it is.

    Raises `UnknownBearingError` if the designation is not in the catalogue; `ValueError` if it is
    neither.
    """
    if isinstance(value, str):
        return asdict(bearing(value))
    if not isinstance(value, Mapping | BearingSection):
        raise ValueError(
            "expected a designation such as '6311', or a table with bore_mm, outer_mm and width_mm"
        )
    return value


def named_bearing(name: str, known: Mapping[str, BearingSection]) -> BearingSection:
    """Return a bearing by name, from the configuration or the catalogue, or from a TOML file.

    Raises `UnknownBearingError` if there is no such name; `SettingsError` if the file cannot be
    used.
    """
    if name in known:
        return known[name]
    if not name.endswith(".toml"):
        return BearingSection.model_validate(bearing_table(name))
    try:
        return BearingSection.model_validate(with_designation(read_toml(Path(name)), name[:-5]))
    except ValidationError as error:
        raise SettingsError(*(f"{name}: {line}" for line in describe_all(error))) from error


def with_designation(table: Any, name: str) -> Any:
    """Give a bearing's table its name where it has none."""
    if isinstance(table, dict):
        return {"designation": Path(name).name[:_LONGEST_NAME]} | table
    return table
