"""Write ``openapi.json`` and ``asyncapi.json``: ``python -m service.web.api.descriptions docs``."""

import json
import sys
from pathlib import Path

from service.web.api.app import descriptions


def write(folder: Path) -> None:
    """Write both files into a folder."""
    for name, document in descriptions().items():
        (folder / name).write_text(json.dumps(document, indent=1, ensure_ascii=False) + "\n")


if __name__ == "__main__":
    write(Path(sys.argv[1]))
