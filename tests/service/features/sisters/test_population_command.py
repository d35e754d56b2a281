"""Sisters on the command line: three random benches teach a fourth."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jsonschema_rs
import numpy as np
import pytest
from numpy.testing import assert_allclose

from adapters.virtual_bench import BenchParameters
from bearing_twin_laboratory.studies.bench_runs import RINGS, Stage, run_bench
from service.cli.many_values import spread
from service.offline.model_file import IdentifiedModel, ModelFileError
from service.offline.model_schema import schema
from service.offline.population_file import Population
from tests.service.offline.files import write

Command = Callable[..., Any]

LIGHT_MIN, HEAVY_MIN = 60, 40
PLAN = (Stage(LIGHT_MIN, 4200.0, 2650.0), Stage(HEAVY_MIN, 4200.0, 4500.0))
SENSORS = list(RINGS)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, run_command: Command) -> Path:
    """``1.json`` to ``3.json`` of sisters, and ``4.csv`` of a target under the light load."""
    found = tmp_path_factory.mktemp("sisters")
    for seed in range(1, 5):
        rows = run_bench(BenchParameters.random(seed), PLAN, seed).minutes
        rows = rows.take(slice(0, LIGHT_MIN)) if seed == 4 else rows
        columns = [rows.time_s, rows.speed_rpm, rows.load_n, rows.ambient_c]
        columns += [rows.temperatures_c[name] for name in RINGS]
        data = write(found / f"{seed}.csv", np.stack(columns, axis=1))
        if seed < 4:
            run_command(*identifying(data, found / f"{seed}.json"))
    return found


def identifying(data: Path, out: Path, *more: object) -> tuple[object, ...]:
    usual = ("--bearing", "6311", "--at-rest", "--method", "refine")
    return ("identify", data, *usual, "--out", out, *more)


def sisters_in(folder: Path) -> list[Path]:
    return [folder / f"{number}.json" for number in (1, 2, 3)]


def changed(path: Path, out: Path, change: Callable[[dict[str, Any]], Any]) -> Path:
    document = json.loads(path.read_text())
    change(document)
    out.write_text(json.dumps(document))
    return out


def test_sisters_and_the_population_that_they_make_are_the_same(
    folder: Path, tmp_path: Path, command: Command
) -> None:
    model, family = tmp_path / "4.json", tmp_path / "family.json"
    told = command(
        *identifying(folder / "4.csv", model, "--sisters", *sisters_in(folder), "--json")
    )
    assert told["sisters"]["used"] == 3
    assert told["sisters"]["accepted"] is True
    assert told["sisters"]["calibrated_runs"] == 3
    assert told["sisters"]["load_n_max"] == pytest.approx(4500.0, rel=0.02)
    assert told["sisters"]["speed_rpm_max"] == pytest.approx(4200.0, rel=0.02)
    made = command("population", *sisters_in(folder), "--out", family, "--json")
    assert (made["sisters"], made["with_data"], made["strangers"]) == (3, 3, {})
    again = command(
        *identifying(folder / "4.csv", tmp_path / "5.json", "--population", family, "--json")
    )
    assert again["parameters"] == told["parameters"]

    profile = tmp_path / "profile.csv"
    profile.write_text("time_s,speed_rpm,load_n,ambient_c\n0,4200,4500,22\n3600,4200,4500,22\n")
    labels = [
        command(
            "forecast", path, "--history", folder / "4.csv", "--profile", profile,
            "--out", tmp_path / "forecast.csv", "--json",
        )["labels"]
        for path in (model, folder / "1.json")
    ]  # fmt: skip
    assert "load law from 3 sisters" in labels[0]
    assert not any("law from" in label for label in labels[1])
    # As a sister of others it says what its own data say, not what it was told.
    loaded = IdentifiedModel.load(model)
    assert loaded.own is not None
    assert Population.of_files([model, folder / "1.json"]).members[0].posterior.sisters is None
    told = command(*identifying(folder / "4.csv", tmp_path / "alone.json", "--json"))
    assert told["sisters"] is None
    assert_allclose(loaded.own.z, IdentifiedModel.load(tmp_path / "alone.json").posterior.z)


def test_a_model_file_carries_its_minute_rows(
    folder: Path, tmp_path: Path, command: Command
) -> None:
    data = IdentifiedModel.load(folder / "1.json").data
    assert data is not None
    (window,) = data.windows
    assert window.at_rest
    assert window.minutes.size == LIGHT_MIN + HEAVY_MIN
    written = np.loadtxt(folder / "1.csv", delimiter=",", skiprows=1)
    assert_allclose(window.minutes.speed_rpm, written[:, 1], rtol=1e-6)
    assert_allclose(window.minutes.temperatures_c[RINGS[1]], written[:, 5], rtol=1e-6)
    bare = tmp_path / "bare.json"
    command(*identifying(folder / "1.csv", bare, "--without-data"))
    assert IdentifiedModel.load(bare).data is None
    assert (folder / "1.json").stat().st_size - bare.stat().st_size < 40_000
    # A sister without rows gives its posterior alone.
    told = command(
        *identifying(
            folder / "4.csv", tmp_path / "4.json", "--json",
            "--sisters", bare, folder / "2.json", folder / "3.json",
        )
    )  # fmt: skip
    assert (told["sisters"]["used"], told["sisters"]["calibrated_runs"]) == (3, 2)
    of_the_schema = jsonschema_rs.Draft202012Validator(schema())
    for name in (folder / "1.json", tmp_path / "4.json"):
        faults = list(of_the_schema.iter_errors(json.loads(name.read_text())))
        assert not faults, faults[0].message[:500]


def test_who_is_no_sister_is_refused_in_one_line(
    folder: Path, tmp_path: Path, complaint: Callable[..., str], command: Command
) -> None:
    one, two, three = sisters_in(folder)
    out = tmp_path / "out.json"

    def refused(*sisters: Path, data: Path = folder / "4.csv") -> str:
        said = complaint(*identifying(data, out, "--sisters", *sisters))
        assert not out.exists()
        return said

    def with_bearing(document: dict[str, Any]) -> None:
        for part in (document["machine"]["bearing"], document):
            part["designation" if part is not document else "bearing"] = "6016"
        document["posterior"]["bearing"] = "6016"

    def with_form(document: dict[str, Any]) -> None:
        for name in ("z", "covariance"):
            rows = document["posterior"][name][:15]
            document["posterior"][name] = [
                row[:15] if isinstance(row, list) else row for row in rows
            ]
        document["posterior"]["samples"] = []
        document["machine"]["model"] = document["posterior"]["model"] = "paper"

    other = changed(two, tmp_path / "other.json", with_bearing)
    assert refused(one, three, other).startswith(f"{other}: bearing '6016', expected bearing '631")
    assert refused(one, three, changed(two, other, with_form)).startswith(
        f"{other}: model 'paper', expected 'default'"
    )
    assert "1 of the model files can be used" in refused(one)
    assert "the same model as" in refused(one, two, one)
    assert "no sister of itself" in refused(one, two, three, data=folder / "3.csv")
    assert "damaged" in refused(
        one, changed(two, other, lambda of: of["rows"][0].update(columns="AAAA"))
    )
    assert "damaged" in refused(
        one, changed(two, other, lambda of: of["posterior"]["covariance"][0].__setitem__(0, -1.0))
    )
    (tmp_path / "cut.json").write_text(two.read_text()[:2000])
    assert "not JSON" in refused(one, tmp_path / "cut.json")

    skipped = command(
        *identifying(
            folder / "3.csv", out, "--sisters", one, two, three, "--skip-strangers", "--json"
        )
    )
    assert list(skipped["skipped"]) == [str(three)]
    assert skipped["sisters"]["used"] == 2


def test_a_damaged_population_is_refused(
    folder: Path, tmp_path: Path, complaint: Callable[..., str], command: Command
) -> None:
    family = tmp_path / "family.json"
    command("population", *sisters_in(folder), "--out", family, "--without-data")
    assert all(member.data is None for member in Population.load(family).members)

    def said(change: Callable[[dict[str, Any]], Any]) -> str:
        path = changed(family, tmp_path / "changed.json", change)
        return complaint(
            *identifying(folder / "4.csv", tmp_path / "o.json", "--population", path)
        ).removeprefix(f"{path}: ")

    assert said(lambda of: of.update(format_version=2)) == "format_version = 2: expected 1"
    assert said(lambda of: of.update(format="else")).startswith("not a population")
    assert said(lambda of: of["members"].pop(0) and of["members"].pop(0)).startswith(
        "1 of the members can be used"
    )
    assert said(lambda of: of["members"][0].pop("posterior")).startswith("damaged population")
    assert "expected one of them" in complaint(
        *identifying(folder / "4.csv", tmp_path / "o.json", "--population", family),
        "--sisters",
        *sisters_in(folder),
    )


def test_families_differ(folder: Path, tmp_path: Path) -> None:
    one, two, three = sisters_in(folder)
    front = changed(one, tmp_path / "front.json", lambda of: of.update(family="front"))
    back = changed(two, tmp_path / "back.json", lambda of: of.update(family="back"))
    with pytest.raises(ValueError, match="family 'back', expected 'front'"):
        Population.of_files([front, back, three])
    found = Population.of_files([front, back, three], skip_strangers=True)
    assert (found.family, len(found.members)) == ("front", 2)
    with pytest.raises(ModelFileError, match="not a model file"):
        Population.of_files([changed(one, tmp_path / "no.json", lambda of: of.update(format="x"))])


def test_values_go_on_until_the_next_option() -> None:
    given = ["DATA", "--sisters", "a", "b", "--json", "c", "--sisters", "d"]
    wanted = ["DATA", "--sisters", "a", "--sisters", "b", "--json", "c", "--sisters", "d"]
    assert spread(given, ("--sisters",)) == wanted
    assert spread(["--sisters", "--json"], ("--sisters",)) == ["--sisters", "--json"]
