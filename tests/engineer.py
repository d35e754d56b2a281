"""What an engineer does with the Python client, on a site that has identified by itself."""

import json
import os
import subprocess
import sys
from datetime import datetime, timedelta
from pathlib import Path

import httpx2
import pytest
from bearing_twin_client import Client, ProblemError, ProfileStep, columns
from bearing_twin_client.documents import JobDocument
from patience import patience
from processes import wait_until

RINGS = ["t_inner_ring_c", "t_outer_ring_c"]
PATIENCE_S = 240.0
#: So many samples are on a page for who does not say how many.
PAGE_ROWS = 10_000
ROOT = Path(__file__).parent.parent


def go_from_a_run_to_a_forecast(url: str, key: str, asset: str) -> None:
    """Every call of the client; an answer that does not fit the types of the client raises."""
    with Client(url, key, timeout_s=PATIENCE_S) as client:
        assert [one.id for one in client.assets()] == [asset]
        assert client.asset(asset).active_model.identified
        assert set(RINGS) <= client.snapshot(asset).tags.keys()
        assert client.state(asset).nodes["t_node_7_c"].std_c > 0
        assert abs(client.verdict(asset).time - client.state(asset).time) < timedelta(hours=1)
        assert {one.asset for one in client.alarms()} == {one.asset for one in client.alarms(asset)}

        read_the_run(client, url, key, asset)
        identify_again(client, asset)

        step = ProfileStep(duration_s=1800, speed_rpm=6200, load_n=2650)
        answer = client.what_if(asset, [step], step_s=60, nodes=RINGS)
        assert set(answer.nodes) == set(RINGS)
        assert answer.time_s[-1] == 1800
        for band in answer.nodes.values():
            assert len(band.q50) == len(answer.time_s)
            assert band.q025[-1] < band.q50[-1] < band.q975[-1]
        assert client.forecast(asset).model_version >= 1
        assert client.envelope(asset).sensors.keys() >= set(RINGS)
        advice = client.advice(asset, speed_rpm=6200, load_n=5500)
        assert advice.steps or advice.excluded

        with pytest.raises(ProblemError) as refused:
            client.what_if(asset, [step, step.model_copy(update={"speed_rpm": 30_000.0})])
        error = refused.value
        assert (error.status, error.title) == (422, "Unprocessable Entity")
        assert error.field == "/profile/1/speed_rpm"
        assert "30000" in error.detail
        with pytest.raises(ProblemError, match="404 Not Found"):
            client.state("no such machine")
    run_the_examples(url, key)
    with Client(url, "bt_wrong") as stranger, pytest.raises(ProblemError, match="401"):
        stranger.assets()


def run_the_examples(url: str, key: str) -> None:
    """The script of docs/connect/client.md and the notebook, as they are printed.

    Of the notebook all but the identification, which a service that identifies by itself, fifty
    times as often as a real one, may refuse.
    """
    page = (ROOT / "docs" / "connect" / "client.md").read_text()
    notebook = json.loads((ROOT / "client" / "from-run-to-forecast.ipynb").read_text())
    cells = ["".join(one["source"]) for one in notebook["cells"] if one["cell_type"] == "code"]
    kept = [cell for cell in cells if "client.identify(" not in cell]
    assert len(kept) == len(cells) - 1
    for script in (page.partition("```python\n")[2].partition("```")[0], "\n".join(kept)):
        done = subprocess.run(
            [sys.executable, "-c", script],
            env=os.environ
            | {"BEARING_TWIN_URL": url, "BEARING_TWIN_KEY": key}
            | {"PYTHONPATH": str(ROOT / "client"), "MPLBACKEND": "Agg"},
            capture_output=True,
            text=True,
            timeout=patience(PATIENCE_S),
            check=False,
        )
        assert done.returncode == 0, done.stderr
        assert " °C (" in done.stdout, "a temperature with its interval"


def read_the_run(client: Client, url: str, key: str, asset: str) -> None:
    """Several pages of samples are as many as one file of the same span has."""
    start = client.state(asset).time - timedelta(hours=1)

    def more_than_a_page() -> datetime | None:
        until = client.state(asset).time
        count = sum(1 for _ in client.measurements(asset, start=start, end=until))
        return until if count > PAGE_ROWS else None

    end = wait_until(more_than_a_page, PATIENCE_S, "more samples than a page has", 1.0)

    def is_same_in_a_file() -> bool:
        """Samples of the span may still be on their way when the first of both is read."""
        whole = httpx2.get(
            f"{url}/api/v1/assets/{asset}/measurements",
            params={"start": start.isoformat(), "end": end.isoformat(), "format": "csv"},
            headers={"X-API-Key": key},
            timeout=patience(PATIENCE_S),
        )
        rows = list(client.measurements(asset, start=start, end=end))
        return len(rows) == len(whole.text.splitlines()) - 1 > PAGE_ROWS

    wait_until(is_same_in_a_file, PATIENCE_S, "as many samples on several pages as in one file")
    found = columns(client.measurements(asset, RINGS, end=end, resolution="1min"))
    assert set(found) == set(RINGS)
    assert all(10 < value < 120 for value in found[RINGS[0]].value if value is not None)


def identify_again(client: Client, asset: str) -> None:
    """Start a job, behind one that the service has begun by itself, and see its version."""

    def started() -> JobDocument | None:
        try:
            return client.identify(asset, method="refine", budget=200)
        except ProblemError as conflict:
            if conflict.status != httpx2.codes.CONFLICT or conflict.problem is None:
                raise
            assert conflict.problem.job is not None, conflict  # noqa: PT017
            client.wait(asset, conflict.problem.job.id, PATIENCE_S)
            return None

    assert client.windows(asset)
    job = client.wait(asset, wait_until(started, PATIENCE_S, "a job").id, PATIENCE_S)
    assert job.status == "succeeded", job.error
    assert job.model_version is not None
    versions = [one.version for one in client.models(asset)]
    assert versions[-1] == 1
    assert job.model_version in versions
    assert client.model(asset, job.model_version).job == job.id
