"""JSON that others send, read so that all of it can be written again."""

import json
from typing import Any

from pydantic_core import from_json


def parse_json(content: bytes) -> Any:
    """Read JSON in UTF-8, UTF-16 or UTF-32.

    Half of a surrogate pair is refused: no answer and no store could hold it. Raises `ValueError`.
    """
    return from_json(content.decode(json.detect_encoding(content)))
