"""Assets that are not in the configuration file, and the templates that they are made from."""

from collections.abc import Mapping
from typing import Literal, Self

from pydantic import Field

from service.clock import rfc3339
from service.documents.base import Document, Page, Time
from service.documents.problems import FieldError
from service.domain.json_values import Json
from service.site.asset_section import AssetSection
from service.site.configuration import TomlTable
from service.site.templates import VALUES, holes_of
from service.store import ProvisionedAsset


class AssetConfiguration(Document):
    """Where an asset is configured, and how."""

    id: str = Field(examples=["axle-1"])
    origin: Literal["file", "provisioned"] = Field(
        description="`file`: only a change of the configuration file changes it."
    )
    template: str | None = Field(description="Null without one.", examples=["axle"])
    revision: int | None = Field(
        description="Grows with each change of any asset; null for the file.", examples=[7]
    )
    changed_at: Time | None = Field(description="Wall time; null for the file.")
    table: dict[str, Json] | None = Field(
        description="As a configuration file would hold it, without the id; null for the file."
    )
    not_running: str | None = Field(
        description="Why the asset is not followed now; null when it is."
    )

    @classmethod
    def of_file(cls, asset: AssetSection, not_running: str | None) -> Self:
        """Show an asset of the configuration file."""
        return cls(
            id=asset.id,
            origin="file",
            template=asset.template or None,
            revision=None,
            changed_at=None,
            table=None,
            not_running=not_running,
        )

    @classmethod
    def of(cls, asset: ProvisionedAsset, not_running: str | None) -> Self:
        """Show an asset of the store."""
        table = asset.table or {}
        return cls(
            id=asset.id,
            origin="provisioned",
            template=table.get("template") or None,
            revision=asset.revision,
            changed_at=rfc3339(asset.changed_us),
            table=table,
            not_running=not_running,
        )


class TemplateDocument(Document):
    """A template of the configuration file."""

    name: str = Field(examples=["axle"])
    asks_for: list[str] = Field(
        description="Values that its holes ask for.", examples=[["gateway", "unit"]]
    )
    values: dict[str, Json] = Field(
        description="Those that it gives itself; an asset may give another.",
        examples=[{"gateway": "gateway-1"}],
    )

    @classmethod
    def of(cls, name: str, template: TomlTable) -> Self:
        """Show a template."""
        return cls(name=name, asks_for=holes_of(template), values=template.get(VALUES, {}))


class ProvisioningDocument(Page):
    """Templates, and the assets that are not in the configuration file, by id."""

    templates: list[TemplateDocument]
    items: list[AssetConfiguration]


class RemovedAsset(Document):
    """An asset that is configured no more, and whose history can be read."""

    id: str = Field(examples=["axle-2"])
    removed_at: Time | None = Field(
        description="Wall time; null for one that stood in the configuration file."
    )


class RemovedAssetList(Page):
    """Assets that are configured no more, by id."""

    items: list[RemovedAsset]


class RejectedAsset(Document):
    """An asset of a list that is not taken."""

    row: int = Field(
        description="Line of the CSV file (the header is line 1); the place from 1 in JSON.",
        examples=[4],
    )
    id: str | None = Field(description="Null where it has none.", examples=["axle-3"])
    detail: str = Field(description="What is wrong and what was expected.")
    errors: list[FieldError] = Field(
        description="Each thing that is wrong; the pointer counts a row of CSV as an asset."
    )


class RemovedAssets(Document):
    """What became of a list of assets that were to be removed."""

    removed: int = Field(examples=[2])


class ImportedAssets(Document):
    """What became of a list of assets."""

    created: int = Field(examples=[2])
    changed: int = Field(examples=[1])
    unchanged: int = Field(description="As they were already.", examples=[0])
    rejected: list[RejectedAsset]
    not_running: Mapping[str, str] = Field(
        description="Which of them are not followed now, and why, by id."
    )
