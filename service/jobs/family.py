"""What the machines of a family know: each keeps its own, and the others ask for it."""

from collections.abc import Mapping
from typing import cast

import numpy as np

from service.jobs.models import machine_of, thermal_model
from service.jobs.relatives import NO_RELATIVES, Relatives
from service.site.asset_section import AssetSection
from service.site.machines.machine import Machine, MachineParts, why_no_sister
from service.site.machines.packed_rows import unpack_rows
from service.store import Store
from service.store.sister_records import SisterRecord
from twin_core.identification.family import BEYOND
from twin_core.identification.posterior import Posterior
from twin_core.sisters import sister_of
from twin_core.sisters.population import FEWEST_SISTERS

#: Sisters by name, with the heaviest load and the highest speed that each has seen.
NewSisters = frozenset[tuple[str, float, float]]


def relatives_of(store: Store, asset: AssetSection) -> Relatives:
    """Read what the other machines of an asset's family know; none without a family.

    Raises
    ------
    StoreUnavailableError
        If the store does not answer.
    """
    if not asset.family:
        return NO_RELATIVES
    machine, model = machine_of(asset), thermal_model(asset)
    sisters, left_out = [], {}
    for record in store.sisters.of_family(asset.family, asset.id):
        try:
            other = Machine.from_dict(cast(MachineParts, record.machine))
            why = why_no_sister(machine, asset.family, other, record.family)
            if why:
                left_out[record.asset] = why
                continue
            own = Posterior.from_dict(record.document["posterior"])
            own.check(model)
            sisters.append(sister_of(record.asset, own, unpack_rows(record.document["rows"])))
        except (KeyError, TypeError, ValueError) as error:
            left_out[record.asset] = f"not readable ({error})"
    return Relatives(sisters, left_out)


def new_sisters(store: Store, asset: AssetSection, active: Posterior) -> NewSisters:
    """Name the sisters that have been where an asset has not, if many of them are new to it.

    Empty where they are not worth another identification: fewer than two, or less than half as
    many new ones as the newest version has asked. A sister that has been farther since is new, too.

    Parameters
    ----------
    store, asset
        Where the records are; whose family.
    active
        Of the asset's active version.

    Raises
    ------
    StoreUnavailableError
        If the store does not answer.
    """
    if not asset.family or not active.identified:
        return frozenset()
    trained, machine = active.trained, dict(machine_of(asset).to_dict())
    farther = [
        record
        for record in store.sisters.summaries_of_family(asset.family, asset.id)
        if record.machine == machine
        and (
            record.load_n_max > BEYOND * trained.load_n_max
            or record.speed_rpm_max > BEYOND * trained.speed_rpm_max
        )
    ]
    asked: dict[str, tuple[float, float]] = {}
    for version in store.models.parts(asset.id, [("sisters",)], 1):
        newest = version.document.get("sisters", {})
        asked = dict.fromkeys(newest.get("set_aside", ()), (np.inf, np.inf))
        reach = zip(newest.get("loads_n", ()), newest.get("speeds_rpm", ()), strict=True)
        asked |= dict(zip(newest.get("names", ()), reach, strict=True))
    new = [record for record in farther if _has_gone_on(record, asked)]
    enough = len(farther) >= FEWEST_SISTERS and 2 * len(new) >= len(farther) - len(new)
    if not (new and enough):
        return frozenset()
    return frozenset((one.asset, one.load_n_max, one.speed_rpm_max) for one in farther)


def _has_gone_on(record: SisterRecord, asked: Mapping[str, tuple[float, float]]) -> bool:
    """Whether a sister was not asked yet, or has been farther since."""
    load_n, speed_rpm = asked.get(record.asset, (0.0, 0.0))
    return record.load_n_max > BEYOND * load_n or record.speed_rpm_max > BEYOND * speed_rpm
