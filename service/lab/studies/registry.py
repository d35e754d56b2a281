"""The studies by name, without the libraries that they need."""

from dataclasses import dataclass
from importlib import import_module

from service.lab.studies.common import Options, Progress, Report, StudyError


@dataclass(frozen=True, slots=True)
class Study:
    """A study and what it understands.

    Parameters
    ----------
    module
        Where its ``run(progress, options)`` is.
    takes
        The fields of `Options` that it heeds.
    needs
        Those without which it cannot run.
    """

    module: str
    takes: tuple[str, ...] = ()
    needs: tuple[str, ...] = ()

    def run(self, progress: Progress, options: Options) -> Report:
        """Run it; its module and the numerical libraries are loaded now."""
        report: Report = import_module(self.module).run(progress, options)
        return report


BENCH_OPTIONS = ("benches", "seed")

STUDIES = {
    "simple-network": Study("service.lab.studies.simple_network"),
    "noa-vs-pso": Study("service.lab.studies.noa_vs_pso"),
    "variable-speed": Study("service.lab.studies.variable_speed", takes=BENCH_OPTIONS),
    "rapid-acceleration": Study("service.lab.studies.rapid_acceleration", takes=BENCH_OPTIONS),
    "sample-size": Study("service.lab.studies.sample_size", takes=BENCH_OPTIONS),
    "reference-nodes": Study("service.lab.studies.reference_nodes", takes=BENCH_OPTIONS),
    "variable-load": Study("service.lab.studies.variable_load", takes=BENCH_OPTIONS),
    "advice": Study("service.lab.studies.advice", takes=BENCH_OPTIONS),
    "drift": Study("service.lab.studies.drift", takes=BENCH_OPTIONS),
    "alarms": Study("service.lab.studies.alarms", takes=BENCH_OPTIONS),
    "field-data": Study("service.lab.studies.field_data", takes=("data",), needs=("data",)),
    "surrogates": Study("service.lab.studies.surrogates", takes=BENCH_OPTIONS),
}

ALL = "all"


def chosen(name: str, options: Options) -> dict[str, Study]:
    """The study of that name; or all of them, but for those that need what is not given.

    Raises
    ------
    StudyError
        If there is no such study (names those there are), or an option does not go with it.
    """
    given = options.given()
    if name == ALL:
        return {title: study for title, study in STUDIES.items() if given.issuperset(study.needs)}
    if name not in STUDIES:
        raise StudyError(f"study {name!r}: expected one of {', '.join(STUDIES)}, {ALL}")
    study = STUDIES[name]
    for field in sorted(given.difference(study.takes)):
        raise StudyError(f"--{field}: the study {name} takes no such option")
    for field in sorted(set(study.needs) - given):
        raise StudyError(f"--{field}: the study {name} needs it")
    return {name: study}
