"""Assets as callers give them."""

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, RootModel

from service.domain.json_values import Json, Table
from service.domain.requests import RequestBody


class AssetTable(RootModel[Table]):
    """The table of an asset as in the configuration file; an `id` is that of the address."""

    model_config = ConfigDict(
        json_schema_extra={
            "examples": [{"template": "axle", "values": {"unit": 11}, "name": "Car 3, axle 1"}]
        }
    )


class AssetToImport(BaseModel):
    """An asset of a list: its id, and its table as in the configuration file."""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, Json]

    id: str = Field(examples=["axle-1"])


class AssetsToRemove(RequestBody):
    """Ids of assets."""

    model_config = ConfigDict(json_schema_extra={"examples": [{"ids": ["axle-1", "axle-2"]}]})

    ids: list[Annotated[str, Field(max_length=200)]] = Field(min_length=1, max_length=100_000)


class AssetsToImport(RequestBody):
    """A list of assets."""

    model_config = ConfigDict(
        json_schema_extra={
            "examples": [
                {
                    "assets": [
                        {"id": "axle-1", "template": "axle", "values": {"unit": 11}},
                        {"id": "axle-2", "template": "axle", "values": {"unit": 12}},
                    ]
                }
            ]
        }
    )

    assets: list[AssetToImport]
