"""bearing-twin drift: has a machine changed between the data of several model files."""

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bearing_twin_laboratory.studies import turbines
from bearing_twin_laboratory.studies.field_data_runs import CASES, LOW_KW, spans
from service.clock import rfc3339
from tests.service.offline.block import CONFIGURATION, NETWORK, recorded

SOUND, WORN = (7.0, 0.06, 0.03), (7.0, 0.042, 0.021)


@pytest.fixture
def model_of(tmp_path: Path, command: Callable[..., Any]) -> Callable[..., Path]:
    """Identify the block from eight hours of a state of it; gives the model file."""
    (tmp_path / "block.toml").write_text(NETWORK)
    (tmp_path / "twin.toml").write_text(CONFIGURATION)

    def identified(values: tuple[float, ...], seed: int) -> Path:
        model = tmp_path / f"model-{seed}.json"
        command(
            "identify", recorded(tmp_path, values=values, seed=seed), "--out", model, "--at-rest",
            "--config", tmp_path / "twin.toml", "--asset", "block-1", "--method", "refine",
        )  # fmt: skip
        return model

    return identified


def test_a_changed_machine_differs_from_an_unchanged_one(
    model_of: Callable[..., Path], command: Callable[..., Any]
) -> None:
    first, again, worn, later = (
        model_of(values, seed) for seed, values in enumerate((SOUND, SOUND, WORN, WORN))
    )
    calm = command("drift", first, again, "--json")
    assert (calm["changed"], calm["text"]) == (False, "no change")
    found = command("drift", first, again, worn, later, "--json")
    assert found["changed"] is True
    assert found["text"].startswith(f"{worn}: friction moved, friction heat at ")
    assert [one["changed"] for one in found["models"]] == [None, False, True, False]
    assert [one["against"] for one in found["models"]] == [None, str(first), str(again), str(worn)]
    moved = found["models"][2]["comparison"]["moves"][0]
    assert moved["quantity"] == "friction"
    assert moved["low"] < -0.3 < moved["high"] < 0.0
    text = command("drift", again, worn)
    assert f"Changed: {worn}: friction moved" in text


def test_models_that_cannot_be_compared_are_refused(
    model_of: Callable[..., Path],
    prior_model: Path,
    tmp_path: Path,
    complaint: Callable[..., str],
) -> None:
    model = model_of(SOUND, 1)
    assert complaint("drift", model) == "MODEL.json: 1 given, expected at least two"
    assert f"{prior_model}: model 'default' of '6311': expected the model, bearing or network" in (
        complaint("drift", model, prior_model)
    )
    other = tmp_path / "other.json"
    other.write_text(model.read_text().replace('"centre": 0.05', '"centre": 0.06'))
    assert "and priors of" in complaint("drift", model, other)
    assert "absent.json: cannot be read" in complaint("drift", model, tmp_path / "absent.json")


RECORDED = Path(os.environ.get("BEARING_TWIN_FIELD_DATA", "/nowhere"))

if RECORDED.is_dir():

    def test_the_change_of_a_recorded_turbines_bearing_is_seen(
        tmp_path: Path, command: Callable[..., Any]
    ) -> None:
        """Its steady rise fell from some 8.5 to 5.7 K between December 2014 and March 2016."""
        case, folder = CASES[0], Path(turbines.__file__).parent / "networks"
        (tmp_path / case.file).write_text((folder / case.file).read_text())
        (tmp_path / "twin.toml").write_text(
            CONFIGURATION.replace("block.toml", case.file).replace("t_block_c", case.sensor)
        )
        models = []
        for day in ("20141029", "20141120", "20160314"):
            model = tmp_path / f"{day}.json"
            data = low_part(RECORDED / f"lhb_R80711_{day}.csv", tmp_path / f"{day}.csv")
            command(
                "identify", data, "--config", tmp_path / "twin.toml", "--asset", "block-1",
                "--method", "refine", "--out", model,
            )  # fmt: skip
            models.append(model)
        found = command("drift", *models[::-1], "--json")["models"]
        assert [one["changed"] for one in found] == [None, False, True]
        assert [one["start"][:7] for one in found] == ["2014-10", "2014-11", "2016-03"]
        rises = [one["quantities"][case.sensor]["value"] for one in found]
        assert min(rises[:2]) > 7.5
        assert rises[2] < 6.5

    def low_part(file: Path, out: Path) -> Path:
        """Spans below 500 kW of one file, as `identify` reads them."""
        case = CASES[0]
        lines = [f"time,speed_rpm,load_n,ambient_c,{case.sensor}"]
        for rows in spans([turbines.read_record(file)], case, LOW_KW):
            table = np.stack(
                [rows.speed_rpm, rows.load_n, rows.ambient_c, rows.temperatures_c[case.sensor]]
            ).T
            lines += [
                ",".join(
                    [rfc3339(round(at * 1e6)), *("" if np.isnan(v) else f"{v:.3f}" for v in row)]
                )
                for at, row in zip(rows.time_s, table, strict=True)
            ]
        out.write_text("\n".join(lines))
        return out
