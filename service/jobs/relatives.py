"""The machines from which a job may learn, as it is handed to a worker."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

from twin_core.sisters import Sister


@dataclass(frozen=True, slots=True, eq=False)
class Relatives:
    """Machines of an asset's family.

    Attributes
    ----------
    sisters
        Those that can be learned from.
    left_out
        The others, with the reason, by asset.
    """

    sisters: Sequence[Sister] = ()
    left_out: Mapping[str, str] = field(default_factory=dict)


NO_RELATIVES: Final = Relatives()
