"""The permissive, "the next step may begin": 1 only while everything that it rests on stands.

The rule is that of the verdict (`GET /assets/{id}/verdict`), whose words are tags. The rest is a
second look at what the verdict rests on. Whatever is missing, old, doubtful or unknown gives 0:
there is no other way to 1 than all conditions at once.
"""

import math
from collections.abc import Collection, Mapping
from typing import Final

from adapters.samples import is_good
from service.documents.verdicts import CODES
from service.plant.protocol import TagValue

NOW, NEXT_STEP, TRUSTED = "verdict.now", "verdict.next_step", "model.trusted"
#: Always of good quality in a snapshot; not so in one that has become too old.
ALARMS_ACTIVE: Final = "alarms.active"
_MUST_BE: Final = {NOW: CODES["safe"], NEXT_STEP: CODES["safe"], TRUSTED: 1}


def may_begin(tags: Mapping[str, TagValue] | None, inputs: Collection[str]) -> bool:
    """Whether the next step may begin."""
    if tags is None:
        return False
    return are_usable(tags, (*inputs, ALARMS_ACTIVE)) and all(
        tag in tags and is_usable(tags[tag]) and tags[tag]["value"] == value
        for tag, value in _MUST_BE.items()
    )


def are_usable(tags: Mapping[str, TagValue], names: Collection[str]) -> bool:
    """Whether every tag of these names has a number of good quality."""
    return all(name in tags and is_usable(tags[name]) for name in names)


def is_usable(shown: TagValue) -> bool:
    """Whether a tag has a number of good quality."""
    value = shown["value"]
    return is_good(shown["quality"]) and value is not None and math.isfinite(value)
