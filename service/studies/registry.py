"""The studies by name."""

from collections.abc import Callable

from service.studies import noa_vs_pso, simple_network
from service.studies.common import Progress, Report, StudyError

STUDIES: dict[str, Callable[[Progress], Report]] = {
    "simple-network": simple_network.run,
    "noa-vs-pso": noa_vs_pso.run,
}

ALL = "all"


def chosen(name: str) -> dict[str, Callable[[Progress], Report]]:
    """The study of that name, or all of them.

    Raises
    ------
    StudyError
        If there is no such study; names those there are.
    """
    if name == ALL:
        return STUDIES
    if name not in STUDIES:
        raise StudyError(f"study {name!r}: expected one of {', '.join(STUDIES)}, {ALL}")
    return {name: STUDIES[name]}
