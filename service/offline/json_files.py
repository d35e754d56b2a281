"""Files of our own as JSON: each names its format and the version of it."""

import json
from pathlib import Path
from typing import Any


def read_json_file(
    path: Path, name: str, version: int, error: type[ValueError], expected: str
) -> dict[str, Any]:
    """Read a file, and check that it is of a format.

    - ``name``, ``version``: the format that is expected, as the file's ``format`` and
      ``format_version``.
    - ``error``: what is raised, with one line for the user.
    - ``expected``: for that line: what the file is not, and who writes one.
    """
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except OSError as failure:
        raise error(f"{path}: cannot be read ({failure.strerror})") from failure
    except ValueError as failure:
        raise error(f"{path}: not JSON ({failure})") from failure
    if not isinstance(document, dict) or document.get("format") != name:
        raise error(f"{path}: not {expected}")
    if document.get("format_version") != version:
        raise error(
            f"{path}: format_version = {document.get('format_version')!r}: expected {version}"
        )
    return document
