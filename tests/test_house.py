"""The figures of the house: each finds what it counts, and nothing else."""

import ast
import json
import subprocess
import sys
from pathlib import Path, PurePosixPath

import pytest

from tools import house

ROOT = Path(__file__).resolve().parents[1]


def module(path: str, text: str) -> house.Module:
    return house.Module(PurePosixPath(path), ast.parse(text))


def test_a_file_of_a_feature_outside_its_folder_is_found_by_name_and_by_import() -> None:
    modules = [
        module("service/features/runs/part.py", "from service.features.runs import tables"),
        module("service/features/runs/runs.py", ""),
        module("service/store/runs.py", ""),
        module("service/cell/cell.py", "from service.features.runs.part import Part"),
        module("service/cell/share.py", "from service.features.runs_of_others import Part"),
    ]
    assert house.files_outside("runs", modules) == ["service/store/runs.py", "service/cell/cell.py"]


def test_names_in_four_packages_and_classes_defined_twice_are_found() -> None:
    text = "class Step: ...\nclass _Own: ...\n"
    modules = [module(f"service/{one}/drift.py", text) for one in ("cell", "live", "store")]
    assert house.scattered_names(modules) == []
    modules.append(module("service/web/drift.py", "class Point: ..."))
    assert house.scattered_names(modules) == ["drift"]
    asked_for = [module(f"service/{one}/errors.py", "") for one in ("bus", "cell", "live", "store")]
    assert house.scattered_names(asked_for) == [], "the root of a package's errors"
    assert house.duplicated_classes(modules) == ["Step"]
    assert house.step_types(modules) == ["Point", "Step"]


def test_errors_without_a_root_of_the_project_and_the_longest_list_of_parameters() -> None:
    text = (
        "class A(ValueError): ...\nclass B(A): ...\nclass C(Base, Exception): ...\n"
        "def f(a, b, *, c): ..."
    )
    modules = [
        module("twin_core/errors.py", text),
        module("service/x.py", "def g(a, b, c, d): ..."),
    ]
    assert house.errors_on_builtins(modules) == ["A"]
    assert house.parameters_max(modules) == (3, "twin_core/errors.py:f")


def test_words_are_counted_in_names_too(tmp_path: Path) -> None:
    file = tmp_path / "words.py"
    file.write_text("told_us = NotToldError('tell whoever runs')  # a hallmark")
    counts = house.words([PurePosixPath(file)])
    assert (counts["tell"], counts["whoever, nobody"], counts["hall"]) == (3, 1, 0)


@pytest.mark.wires
def test_the_command_prints_one_document() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "tools.house", "--json"], cwd=ROOT, capture_output=True, check=True
    )
    found = json.loads(done.stdout)
    assert set(found["files_outside_feature"]) == set(house.FEATURES)
    assert found["product_lines"] > found["test_lines"] > 10_000
    assert all("tests/" not in path for path in found["step_types"])
