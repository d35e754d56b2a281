"""The page's pure modules: tests in JavaScript, and two answers that Python compares."""

import csv
import io
import json
import random
import re
import subprocess
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import pytest
from patience import patience
from programs import needed

from service.alarms.records import normal_alarm, urgency
from service.alarms.states import AlarmState
from service.documents.alarms import alarm_document
from service.domain.alarm_condition import AlarmCondition
from service.spreadsheets import text_cell
from service.web.pages import static_directory

pytestmark = pytest.mark.wires

HERE = Path(__file__).parent


def node(*arguments: str, given: str = "") -> str:
    """Standard output of Node.js, with the zone and the language of the browser's tests."""
    ran = subprocess.run(
        [needed("nodejs", "node"), *arguments],
        input=given, capture_output=True, text=True, timeout=patience(120), check=False,
        env={"TZ": "Europe/Berlin", "LC_ALL": "en_GB.UTF-8"},
    )  # fmt: skip
    assert ran.returncode == 0, ran.stdout + ran.stderr
    return ran.stdout


def answer(module: str, expression: str, given: Any) -> Any:
    """What a function of a module of the page and of `given` makes of them."""
    address = (static_directory() / "js" / module).as_uri()
    script = f"""
      import {{ readFileSync }} from 'node:fs';
      const given = JSON.parse(readFileSync(0, 'utf-8'));
      console.log(JSON.stringify(({expression})(await import('{address}'), given)));
    """
    return json.loads(node("--input-type=module", "--eval", script, given=json.dumps(given)))


@pytest.mark.parametrize("file", sorted(path.name for path in HERE.glob("*.test.js")))
def test_modules_of_the_page(file: str) -> None:
    report = node("--test-reporter=tap", str(HERE / file))
    assert re.search(r"^# pass [1-9]", report, re.MULTILINE), report


def test_the_service_lists_alarms_in_the_order_of_the_page() -> None:
    facts = [
        {"kind": kind, "predicted": predicted, "channel": channel}
        for kind, predicted, channel in (
            ("measured limit", False, "t_inner_ring_c"),
            ("stale data", False, "source:push"),
            ("sensor fault", False, "t_outer_ring_c"),
            ("forecast limit", True, "t_inner_ring_c"),
        )
    ]
    condition = AlarmCondition(
        "bench-1", "measured limit", "t_inner_ring_c", "warning", True, 91.0, "over warning", 2
    )
    one = normal_alarm(condition, 0)
    alarms = [
        replace(one, id=f"{number:03}", state=state.value, priority=priority, **fact)
        for number, (state, priority, fact) in enumerate(
            product(AlarmState, (1, 2, 3), facts), start=100
        )
        if state != AlarmState.NORM
    ]
    # No two at the same time; some were suppressed before they were ever raised.
    alarms = [
        replace(each, since_us=time_us, raised_at_us=time_us if each.state != "DSUPR" else 0)
        for each, time_us in zip(alarms, range(10**15, 10**16, 10**12), strict=False)
    ]
    shuffled = random.Random(5).sample(alarms, len(alarms))
    documents = [alarm_document(each).model_dump(mode="json") for each in shuffled]
    by_id = "(page, all) => page.ranked(new Map(all.map((one) => [one.id, one])))"
    order = [each["id"] for each in answer("alarms/alarm.js", by_id, documents)]
    assert order == [each.id for each in sorted(alarms, key=urgency)]


def test_no_cell_of_the_journal_that_a_page_saves_is_a_formula() -> None:
    texts = ["=1+1", "@x", "+1+2", "-2+3", "\t=1", "\uff1d1", "-3.5", "seen"]
    texts += ["seen;=1+1;-3", 'a;"=1', "a\r\n=1", " =1", "\ufeff=1"]
    lines = [{"comment": text} for text in texts]
    saved = answer("alarms/journal.js", "(page, lines) => page.journalCsv(lines)", lines)
    cells = [row["comment"] for row in csv.DictReader(io.StringIO(saved, newline=""))]
    assert cells == [text_cell(text) for text in texts]
    assert cells[-5:] == ["seen;'=1+1;-3", "a;'\"=1", "a\r\n'=1", "' =1", "'\ufeff=1"]
