"""A copy of the assets of the store: their devices are read at a start without the store, too."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Final

import structlog

from service.files import FileError, replacing
from service.site.configuration import TomlTable

FILE_NAME: Final = "assets.json"

_log = structlog.get_logger(__name__)


def keep_copy(data_dir: Path, assets: Mapping[str, TomlTable]) -> None:
    """Write the tables of all assets by id; what cannot be written is said, and done without."""
    try:
        with replacing(data_dir / FILE_NAME, private=True) as file:
            json.dump(assets, file)
    except FileError as error:
        _log.warning("assets_not_copied", reason=str(error))


def read_copy(data_dir: Path) -> dict[str, TomlTable]:
    """Give the tables that were written last; none where there is no copy that can be read."""
    file = data_dir / FILE_NAME
    try:
        found = json.loads(file.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return {}
    except (OSError, ValueError, RecursionError) as error:
        _log.warning("copy_of_assets_not_read", file=str(file), reason=str(error))
        return {}
    if not isinstance(found, dict):
        return {}
    return {name: table for name, table in found.items() if isinstance(table, dict)}
