"""Write ``model.schema.json``, what a model file looks like: ``python -m … docs``."""

import json
import sys
from pathlib import Path
from typing import Any, Final, Literal

from pydantic import BaseModel, ConfigDict, Field

from service.offline.model_file import FORMAT_VERSION
from service.site.machines.bearings import BearingSection
from service.site.machines.networks import NetworkSection

NAME: Final = "model.schema.json"


class _Part(BaseModel):
    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)


class Span(_Part):
    """A span of constant speed and load, or of varying duty; means over it."""

    speed_rpm: float = Field(description="Speed in rpm.")
    load_n: float = Field(description="Load in N.")
    duration_s: float = Field(description="Length in s.")
    start_s: float = Field(description="Begin in s, counted from the first row of the data.")


class Trained(_Part):
    """The operation that the model was identified from."""

    operating_points: list[Span] = Field(description="Spans of constant speed and load, in order.")
    minutes: int = Field(ge=0, description="Rows of the data; 0 before any identification.")
    from_rest: bool = Field(description="Whether it began on a machine at standstill.")
    revolutions: float = Field(description="Revolutions since fresh grease, at the first row.")
    ambient_c: float | None = Field(None, description="Mean ambient temperature in °C.")
    duty: list[Span] = Field(
        default_factory=list, description="Where the machine ran while it was held nowhere."
    )
    drives: dict[str, float] = Field(
        default_factory=dict,
        description="Input of a network by name: what its size exceeds in one row of twenty.",
    )


class CalibrationRun(_Part):
    """One sister played as the target: forecast from its easy part, scored over the rest."""

    bearing: str = Field(description="Which sister.")
    load_n_max: float = Field(description="Heaviest load in N of the part that was forecast.")
    speed_rpm_max: float = Field(description="Highest speed in rpm of that part.")
    needed: dict[str, float] = Field(
        description="By sensor: the factor on its band that would have held 95 % of the readings."
    )
    needed_whole: dict[str, float] = Field(
        default_factory=dict,
        description="By sensor: the factor on its band of the whole run that would have held all "
        "of these readings. Empty in files of earlier versions.",
    )


class LawPart(_Part):
    """Where one law comes from, and what speaks for it."""

    source: Literal["own", "family", "literature"] = Field(description="What decides it.")
    weight_family: float = Field(description="Probability of the family's law, 0 to 1.")
    log_bayes_factor: float | None = Field(
        description="Natural logarithm, of the family's law against the literature's."
    )
    tested: bool = Field(description="Whether the machine's own data say anything about it.")
    settled_by: str | None = Field(description="What would test it; null where it is tested.")


class Sisters(_Part):
    """Which sisters the prior was made of."""

    names: list[str] = Field(description="Of the sisters.")
    loads_n: list[float] = Field(description="Heaviest load in N that each has seen.")
    speeds_rpm: list[float] = Field(description="Highest speed in rpm that each has seen.")
    calibration: list[CalibrationRun] = Field(description="Empty where their rows are not known.")
    laws: dict[str, LawPart] = Field(
        default_factory=dict, description="By load, speed, start and housing; none in older files."
    )


class WindowPart(_Part):
    """Minute rows of one window, packed."""

    at_rest: bool = Field(description="Whether the machine stood at ambient at the first row.")
    revolutions: float = Field(description="Revolutions since fresh grease, at the first row.")
    rows: int = Field(ge=0, description="How many rows.")
    columns: str = Field(
        description="NumPy's compressed arrays (.npz) in base64: time_s, speed_rpm, load_n, "
        "ambient_c, and temperature.NAME or input.NAME for each sensor and input."
    )


class PosteriorPart(_Part):
    """What is known of the parameters, in standard coordinates z.

    A parameter is centre * exp(spread * z) with transform "log", else centre + spread * z, within
    its bounds; before any data z is standard normal. The order is that of the model's parameters.
    """

    model: str = Field(description="Name of the model.")
    bearing: str = Field(description="Designation of the bearing, or name of the network.")
    z: list[float] = Field(description="(p,) most probable coordinates.")
    covariance: list[list[float]] = Field(description="(p, p) covariance around them.")
    samples: list[list[float]] = Field(description="(k, p) samples, which forecasts use.")
    sensor_lag_s: float = Field(ge=0, description="Lag of the temperature sensors in s.")
    train_rms_k: dict[str, float] = Field(description="Error in the data by sensor, rms in K.")
    cost_per_residual: float = Field(description="Mean squared whitened residual.")
    rank: int = Field(ge=0, description="Rank of the whitened sensitivities.")
    condition: float = Field(description="Condition of the whitened sensitivities.")
    informed_combinations: int = Field(ge=0, description="Combinations that the data decide.")
    trained: Trained
    evaluations: int = Field(ge=0, description="Simulations of the data that it took.")
    sisters: Sisters | None = Field(None, description="Missing without sisters.")


class RunInPart(_Part):
    """Revolutions of the shaft over the data: the run-in state of the grease."""

    start_us: int | None = Field(
        description="UTC microseconds from which time_s counts; null for data without dates."
    )
    at_rest: bool = Field(description="Whether the machine stood at ambient at the first row.")
    time_s: list[float] = Field(min_length=1, description="(n,) some rows, first and last.")
    revolutions: list[float] = Field(
        min_length=1, description="(n,) counted from the first row of the data."
    )
    temperatures_c: dict[str, list[float | None]] = Field(
        description="(n,) °C by sensor; null where nothing was measured."
    )


class MachinePart(_Part):
    """What the model is built of: a bearing, or a network of the user's own."""

    model: str = Field(description="Which of the models of a bearing.")
    bearing: BearingSection | None = Field(description="Dimensions in mm, rating in N.")
    network: NetworkSection | None = Field(description="null for the network of a bearing.")


class ModelFile(BaseModel):
    """A model that `bearing-twin identify` wrote, with everything that a forecast needs.

    Later versions may add members; readers leave out what they do not know.
    """

    model_config = ConfigDict(extra="allow", title="Bearing Twin model file")

    format: Literal["bearing-twin model"]
    format_version: Literal[1]
    model: str = Field(description="Name of the model.")
    bearing: str = Field(description="Designation of the bearing, or name of the network.")
    machine: MachinePart
    posterior: PosteriorPart
    run_in: RunInPart
    family: str = Field("", description="Of machines of one type, grease and arrangement.")
    own: PosteriorPart | None = Field(
        None, description="What its own data say without sisters; missing where that is the same."
    )
    rows: list[WindowPart] | None = Field(
        None, description="The minute rows of the data; missing with --without-data."
    )


def schema() -> dict[str, Any]:
    """Return the schema (JSON Schema 2020-12) of the files that are written."""
    head = {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "$id": f"urn:bearing-twin:model:{FORMAT_VERSION}",
    }
    return head | ModelFile.model_json_schema(mode="serialization")


if __name__ == "__main__":
    text = json.dumps(schema(), indent=1, ensure_ascii=False)
    Path(sys.argv[1], NAME).write_text(f"{text}\n", encoding="utf-8")
