"""The page's modules agree with each other and with what the REST interface answers."""

import json
import re
import subprocess
from pathlib import Path

import pytest
from patience import patience
from programs import needed, node_package

from service.web.pages import static_directory
from tools.page_types import OPENAPI, declarations

pytestmark = pytest.mark.wires

HERE = Path(__file__).parent
PAGES = static_directory().parent
#: Reads a member that no alarm has: proof that types of answers reach the modules.
WRONG = """
import { assetPath, call, callPages } from '%s/js/app/api.js';
const [alarm] = await callPages('/alarms', {});
console.log(alarm.message, alarm.massage);
const forecast = await call(assetPath('bench-1', '/forecast'));
console.log(forecast.made_at, forecast.mode_at);
"""


def test_types_of_the_page(tmp_path: Path) -> None:
    compiler = node_package("typescript", HERE) / "bin" / "tsc"
    types, wrong = tmp_path / "api.d.ts", tmp_path / "wrong.js"
    types.write_text(declarations(json.loads(OPENAPI.read_text("utf-8"))), "utf-8")
    wrong.write_text(WRONG % static_directory().as_posix(), "utf-8")
    sources = [static_directory() / "js", PAGES / "page.d.ts", types, wrong]
    project = tmp_path / "tsconfig.json"
    project.write_text(
        json.dumps(
            {"extends": str(PAGES / "tsconfig.json"), "include": [str(one) for one in sources]}
        )
    )
    ran = subprocess.run(
        [needed("nodejs", "node"), str(compiler), "--pretty", "false", "--project", str(project)],
        capture_output=True, text=True, timeout=patience(240), check=False, cwd=tmp_path,
    )  # fmt: skip
    errors = re.findall(r"^(\S+)\(\d.*?error (?:TS\d+): (.*)$", ran.stdout, re.MULTILINE)
    own = [error for error in errors if error[0] != "wrong.js"]
    assert not own, ran.stdout
    refused = "Property '(.*?)' does not exist"
    assert re.findall(refused, ran.stdout) == ["massage", "mode_at"], ran.stdout + ran.stderr
