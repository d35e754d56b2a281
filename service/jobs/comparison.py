"""Compares a new model version with earlier ones: whether it says that the machine has changed.

The new version is compared with an earlier one whose operation was most like its own, and slow
changes are summed up over all versions that share no data. Versions from before a change that was
reported and then made active no longer count: the machine is what it is now.
"""

import contextlib
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Final

import structlog

from service.documents.models import (
    NOT_COMPARED,
    DriftComparison,
    DriftDocument,
    DriftMove,
    DriftQuantity,
    DriftReference,
)
from service.store import Store
from service.store.records import ModelVersion
from twin_core.drift import Drift, compare, usual_point
from twin_core.drift_series import follow, values_of
from twin_core.identification.identify import fit_problem
from twin_core.identification.posterior import Posterior
from twin_core.models import ThermalModel
from twin_core.quantities import ReferencePoint
from twin_core.similarity import nearest
from twin_core.windows import Window

# Newest versions that a new one is compared with. With one each night most share data with it.
_MOST_VERSIONS: Final = 50
_COMPARED: Final = (
    ("machine",),
    ("window_records",),
    ("drift",),
    ("job",),
    *(
        (of, key)
        # With sisters it is the machine's own data that are compared.
        for of in ("posterior", "own")
        for key in (
            "model",
            "bearing",
            "z",
            "covariance",
            "sensor_lag_s",
            "train_rms_k",
            "cost_per_residual",
            "rank",
            "condition",
            "informed_combinations",
            "trained",
            "evaluations",
        )
    ),
    ("posterior", "sisters"),
)
# Every version in the series costs a quarter of a second.
_LONGEST_SERIES = 12
# Data that overlap by less than this are not the same data.
_MINUTE_S = 60.0

_log = structlog.get_logger(__name__)


@dataclass(frozen=True, slots=True, eq=False)
class EarlierVersion:
    """What is needed of a stored version.

    Attributes
    ----------
    version : int
        Its number.
    posterior : Posterior
        What is known of the parameters.
    windows : sequence of Window
        The windows it was identified from.
    point : ReferencePoint or None
        Where its quantities are stated.
    reported : bool
        Whether a change was reported at it.
    was_active : bool
        Whether it is or was the active one.
    """

    version: int
    posterior: Posterior
    windows: Sequence[Window]
    point: ReferencePoint | None
    reported: bool
    was_active: bool


def comparable_versions(store: Store, asset_id: str) -> list[ModelVersion]:
    """Give the newest versions of an asset with what a comparison needs of their documents.

    Most of a document are the posterior's samples, for which no comparison asks.
    """
    found = store.models.parts(asset_id, _COMPARED, _MOST_VERSIONS)
    for version in found:
        for part in ("posterior", "own"):
            if version.document.get(part) is not None:
                version.document[part]["samples"] = []
    return found


def earlier_versions(versions: Sequence[ModelVersion]) -> list[EarlierVersion]:
    """Take from stored versions what `drift_document` needs, oldest first.

    What cannot be read is left out: it is of another machine, or of a release with other
    parameters.
    """
    found = []
    for version in versions:
        drift = version.document.get("drift") or {}
        point = drift.get("point")
        try:
            known = EarlierVersion(
                version.version,
                Posterior.from_dict(version.document.get("own") or version.document["posterior"]),
                [Window.from_dict(one) for one in version.document["window_records"]],
                None if point is None else ReferencePoint(**point),
                bool(drift.get("changed")),
                version.status in ("active", "retired"),
            )
        except (KeyError, TypeError, ValueError):
            continue
        found.append(known)
    return found


def drift_document(
    model: ThermalModel,
    posterior: Posterior,
    windows: Sequence[Window],
    earlier: Sequence[EarlierVersion],
) -> DriftDocument:
    """Compare a newly identified posterior with stored versions.

    Parameters
    ----------
    model
        Of the new posterior; versions of another model are left out.
    posterior, windows
        The new posterior and the data behind it.
    earlier
        Stored versions, oldest first.

    Returns
    -------
    DriftDocument
        ``changed`` is None where nothing could be compared; ``text`` says why.
    """
    problem = fit_problem(posterior, model.errors)
    if problem:
        return _nothing(
            f"not compared: the fit failed ({problem}), possibly by a change within the data"
        )
    known = _comparable(model, earlier)
    points = [version.point for version in known if version.point is not None]
    point = points[0] if points else usual_point(model, posterior)
    document = _nothing("the first version, without an earlier one to compare with")
    document.point = DriftReference(**asdict(point))
    document.quantities = {
        one.quantity.name: DriftQuantity(
            text=one.quantity.text,
            group=one.quantity.group,
            unit=one.quantity.unit,
            value=one.value,
            low=one.low,
            high=one.high,
        )
        for one in values_of(model, posterior, point)
    }
    unchanged = _since_the_last_change(known)
    chosen = nearest([version.posterior for version in unchanged], posterior)
    if not chosen:
        return document
    version = unchanged[chosen[-1]]
    shared = _shared(version.windows, windows)
    drift = compare(model, version.posterior, posterior, shared=shared, point=point)
    series = [one.posterior for one in _without_shared_data(unchanged, windows)]
    last = follow(model, [*series[-_LONGEST_SERIES:], posterior], point)[-1]
    document.changed, document.text = drift.changed or bool(last.creeping), drift.text
    if last.creeping and not drift.changed:
        document.text = f"creeping change of {', '.join(last.creeping)} over the last versions"
    document.comparison = _comparison(version.version, shared, drift)
    document.sums, document.creeping = dict(last.sums), list(last.creeping)
    return document


def with_drift(reason: str, drift: DriftDocument) -> str:
    """Reason of a version's status, with the change that it reports.

    It becomes the comment in the journal of activations when it is activated automatically.
    """
    return f"{reason}; drift: {drift.text}" if drift.changed else reason


def report_change(asset_id: str, version: ModelVersion, record: Callable[[str], object]) -> None:
    """Write it into the service's log, and into a record, when a version reports a change."""
    drift = version.document.get("drift") or {}
    if drift.get("changed"):
        _log.warning("drift_reported", asset=asset_id, version=version.version, text=drift["text"])
        record(change_line(version.version, drift["text"]))


def change_line(version: object, text: str) -> str:
    """Line of the journal about a version that reports a change."""
    return f"Model version {version}: {text}"


def _nothing(text: str) -> DriftDocument:
    return NOT_COMPARED.model_copy(update={"text": text})


def _comparison(version: int, shared: float, drift: Drift) -> DriftComparison:
    return DriftComparison(
        version=version,
        shared=shared,
        alike=drift.similarity.text,
        statistic=drift.statistic,
        dimensions=drift.dimensions,
        probability=drift.probability,
        groups=dict(drift.groups),
        moves=[
            DriftMove(
                quantity=move.quantity.name,
                text=move.text,
                change=move.change,
                low=move.low,
                high=move.high,
            )
            for move in drift.moves
        ],
    )


def _comparable(model: ThermalModel, earlier: Sequence[EarlierVersion]) -> list[EarlierVersion]:
    """Versions of this model that were identified from data and whose fit did not fail."""
    found = []
    for version in earlier:
        posterior = version.posterior
        with contextlib.suppress(ValueError):
            posterior.check(model)
            if posterior.identified and not fit_problem(posterior, model.errors):
                found.append(version)
    return found


def _since_the_last_change(known: Sequence[EarlierVersion]) -> list[EarlierVersion]:
    """Versions of the machine as it is now."""
    start = max((k for k, one in enumerate(known) if one.reported and one.was_active), default=0)
    return [one for one in known[start:] if one.was_active or not one.reported]


def _without_shared_data(
    known: Sequence[EarlierVersion], windows: Sequence[Window]
) -> list[EarlierVersion]:
    """Of versions those that share data neither with given windows nor with each other."""
    taken = list(windows)
    found = []
    for version in reversed(known):
        if _shared(version.windows, taken) == 0.0:
            taken += version.windows
            found.append(version)
    return found[::-1]


def _shared(windows: Sequence[Window], others: Sequence[Window]) -> float:
    """Part of the time of windows that lies in others too, 0 to 1."""
    total = sum(window.duration_s for window in windows)
    common = sum(
        max(min(one.end_s, other.end_s) - max(one.start_s, other.start_s), 0.0)
        for one in windows
        for other in others
    )
    if total <= 0.0 or common <= _MINUTE_S:
        return 0.0
    return min(common / total, 1.0)
