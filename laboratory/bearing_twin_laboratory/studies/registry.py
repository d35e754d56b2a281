"""The studies by name, without the libraries that they need."""

from dataclasses import dataclass
from importlib import import_module

from bearing_twin_laboratory.studies.processes import Progress
from bearing_twin_laboratory.studies.study import Options, Report, StudyError

ALL = "all"
_BENCHES = ("benches", "seed")


@dataclass(frozen=True, slots=True)
class Entry:
    """A study that is loaded when it is run.

    - ``module``: where its ``STUDY`` is.
    - ``takes``, ``needs``: the fields of `Options` that it heeds, and those without which it cannot
      run.
    """

    module: str
    takes: tuple[str, ...] = ()
    needs: tuple[str, ...] = ()

    def run(self, progress: Progress, options: Options) -> Report:
        """Run it; its module and the numerical libraries are loaded now."""
        report: Report = import_module(f"{__package__}.{self.module}").STUDY.run(progress, options)
        return report


STUDIES = {
    "simple-network": Entry("simple_network"),
    "noa-vs-pso": Entry("noa_vs_pso"),
    "variable-speed": Entry("variable_speed", takes=_BENCHES),
    "rapid-acceleration": Entry("rapid_acceleration", takes=_BENCHES),
    "sample-size": Entry("sample_size", takes=_BENCHES),
    "reference-nodes": Entry("reference_nodes", takes=_BENCHES),
    "variable-load": Entry("variable_load", takes=_BENCHES),
    "calibration": Entry("calibration", takes=_BENCHES),
    "sisters": Entry("sisters", takes=_BENCHES),
    "trust": Entry("trust", takes=_BENCHES),
    "runaway": Entry("runaway", takes=_BENCHES),
    "advice": Entry("advice", takes=_BENCHES),
    "ledger": Entry("ledger", takes=_BENCHES),
    "drift": Entry("drift", takes=_BENCHES),
    "alarms": Entry("alarms", takes=_BENCHES),
    "field-data": Entry("field_data", takes=("data",), needs=("data",)),
    "recorded-sisters": Entry("recorded_sisters", takes=("data",), needs=("data",)),
    "recorded-alarms": Entry("recorded_alarms", takes=("data",), needs=("data",)),
}


def chosen(name: str, options: Options) -> dict[str, Entry]:
    """The study of that name; or all of them, but for those that need recorded data.

    Raises `StudyError` if there is no such study (names those there are), or an option does not go
    with it.
    """
    given = options.given()
    if name == ALL:
        if "data" in given:
            raise StudyError("--data: each study of recorded data has files of its own; name it")
        return {title: study for title, study in STUDIES.items() if not study.needs}
    if name not in STUDIES:
        raise StudyError(f"study {name!r}: expected one of {', '.join(STUDIES)}, {ALL}")
    study = STUDIES[name]
    for field in sorted(given.difference(study.takes)):
        raise StudyError(f"--{field}: the study {name} takes no such option")
    for field in sorted(set(study.needs) - given):
        raise StudyError(f"--{field}: the study {name} needs it")
    return {name: study}
