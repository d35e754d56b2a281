"""The templates by which the assets of the store were followed last.

A template with a hole that no asset fills would stop every machine at the next start. Where more
than a tenth of the assets are lost in this way, they are followed by the templates before.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import structlog
from pydantic import ValidationError

from service.files import FileError, replacing
from service.site.asset_tables import CheckedAsset, check_assets
from service.site.configuration import TomlTable
from service.site.machines.bearings import BearingSection
from service.site.settings import Settings

FILE_NAME: Final = "templates.json"
#: Losing more of all assets is taken for a mistake in the configuration.
LOST_MAX: Final = 0.1

_log = structlog.get_logger(__name__)


@dataclass(frozen=True, slots=True)
class CheckedAssets:
    """The assets of the store, checked at a start.

    Attributes
    ----------
    right
        Those that are followed.
    wrong
        What is wrong with those that cannot be.
    kept
        Of `right`: what is wrong with those that are followed by the last templates.
    """

    right: dict[str, CheckedAsset]
    wrong: dict[str, str]
    kept: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class LastTemplates:
    """What the file holds: templates, bearings, and assets that are followed by them only."""

    templates: tuple[TomlTable, ...]
    bearings: dict[str, BearingSection]
    kept: frozenset[str]


def check_at_start(settings: Settings, tables: Mapping[str, TomlTable]) -> CheckedAssets:
    """Check the assets of the store by the configuration, or by the templates before."""
    right, lines = check_assets(settings, tables)
    wrong = {name: "; ".join(each) for name, each in lines.items()}
    last = read_last(settings.data_dir) if wrong else None
    if last is None:
        return CheckedAssets(right, wrong)
    before = settings.model_copy(update={"templates": last.templates, "bearings": last.bearings})
    kept, _ = check_assets(before, {name: tables[name] for name in wrong})
    if len(kept) <= LOST_MAX * (len(tables) + len(settings.assets)):
        return CheckedAssets(right, wrong)
    return CheckedAssets(
        right | kept,
        {name: why for name, why in wrong.items() if name not in kept},
        {name: why for name, why in wrong.items() if name in kept},
    )


def keep_last(settings: Settings, kept: Mapping[str, str]) -> set[str]:
    """Write down by which templates the assets are followed; gives those that are kept newly."""
    before = read_last(settings.data_dir) if kept else None
    if before is None:
        templates: tuple[TomlTable, ...] = settings.templates
        bearings, known = settings.bearings, frozenset[str]()
    else:
        templates, bearings, known = before.templates, before.bearings, before.kept
    document = {
        "templates": templates,
        "bearings": {name: one.model_dump(mode="json") for name, one in bearings.items()},
        "kept": sorted(kept),
    }
    try:
        with replacing(settings.data_dir / FILE_NAME, private=True) as file:
            json.dump(document, file)
    except (FileError, TypeError) as error:
        _log.warning("templates_not_kept", reason=str(error))
    return set(kept) - known


def read_last(data_dir: Path) -> LastTemplates | None:
    """Give what was written last; None where there is nothing that can be read."""
    file = data_dir / FILE_NAME
    try:
        found = json.loads(file.read_text(encoding="utf-8"))
        bearings = found["bearings"].items()
        return LastTemplates(
            tuple(found["templates"]),
            {name: BearingSection.model_validate(table) for name, table in bearings},
            frozenset(found["kept"]),
        )
    except FileNotFoundError:
        return None
    except (
        OSError, ValueError, RecursionError, LookupError, TypeError, AttributeError,
        ValidationError,
    ) as error:  # fmt: skip
        _log.warning("last_templates_not_read", file=str(file), reason=str(error))
        return None
