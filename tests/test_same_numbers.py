"""Regression check of numbers: a changed number is reported, one that wanders within its deviation is not."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from tests.same_numbers import compare

RESULT = {"value": 1632.0, "std": 2.0, "seconds": 3.1, "verdict": "none"}


@pytest.mark.parametrize(
    ("changed", "within", "differing"),
    [
        ({}, 0.0, 0),
        ({"seconds": 9.9}, 0.0, 0),
        ({"value": 1632.0000000000002}, 0.0, 1),
        ({"value": 1632.01}, 0.01, 0),
        ({"value": 1632.03}, 0.01, 1),
        ({"verdict": "end_stop"}, 0.01, 1),
        ({"value": None}, 0.01, 1),
    ],
)
def test_a_changed_number_is_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], changed: dict[str, Any], within: float, differing: int
) -> None:
    for folder, content in (("before", RESULT), ("after", RESULT | changed)):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "fit.json").write_text(json.dumps({"parameters": {"k": content}}))
    assert compare(tmp_path / "before", tmp_path / "after", within) == differing
    assert f"fit.json.parameters.k.{next(iter(changed), '')}" in capsys.readouterr().out or not differing


def test_a_result_that_is_missing_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "fit.json").write_text("{}")
    assert compare(tmp_path, tmp_path / "after", 0.0) == 1
    assert "only in one of the folders" in capsys.readouterr().out
