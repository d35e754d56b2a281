"""No model of values in another unit becomes active without a person."""

import numpy as np

from service.domain.channels import AMBIENT, LOAD, SPEED
from service.site.machines.bearings import BearingSection
from service.site.machines.plausibility import doubts_of_rows
from twin_core.identification.data import IdentificationData
from twin_core.identification.gates import GateCheck, GateReport

#: Name of the gate.
UNITS = "units"


def unless_in_another_unit(
    report: GateReport, bearing: BearingSection | None, data: IdentificationData
) -> GateReport:
    """Refuse a model whose windows have a load or an ambient temperature that no machine has.

    The fit cannot show it: a wrong unit fits as well, and the forecast of another load is wrong.
    """
    rows = [window.minutes for window in data.windows]
    columns = {
        name: np.concatenate([getattr(one, name) for one in rows])
        for name in (SPEED, LOAD, AMBIENT)
    }
    for doubt in doubts_of_rows(bearing, columns, np.empty(0)):
        if doubt.weight != "said":
            report = report.refused_by(GateCheck(UNITS, False, doubt.text, {}))
    return report
