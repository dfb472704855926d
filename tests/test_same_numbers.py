"""Record of what users get: what changed is reported in the user's words, what differs by rule is not."""

from __future__ import annotations

import json
from copy import deepcopy
from pathlib import Path
from typing import Any

import pytest
from spool_tools.cli import app
from typer.main import get_command

from tests.same.collecting import Collection, expanded, masked, without_run
from tests.same.public import commands
from tests.same.reading import content, page_text
from tests.same_numbers import ROOT, compare, differences

FIT = {"k": {"value": 1632.0, "std": 2.0}, "gap": 5.0, "verdict": "none"}
RESULT = {"run": "fit bag", "exit": 0, "text": ["fitted", "force 0.312 N"], "files": {"fit.json": FIT}}


@pytest.mark.parametrize(
    ("path", "value", "within", "relative", "reported"),
    [
        (("exit",), 0, 0.0, 0.0, None),
        (("exit",), 1, 0.0, 0.0, "exit: 0 -> 1"),
        (("text", 0), "", 0.0, 0.0, "text, line 1: 'fitted' -> ''"),
        (("text", 1), "force 0.313 N", 0.0, 0.0, "text, line 2: 'force 0.312 N' -> 'force 0.313 N'"),
        (("text", 1), "force 0.313 N", 0.0, 0.01, None),
        (("text", 1), "force 0.312 kN", 0.0, 0.01, "text, line 2: 'force 0.312 N' -> 'force 0.312 kN'"),
        (("k", "value"), 1632.0000000000002, 0.0, 0.0,
         "files, fit.json, k, value: 1632.0 -> 1632.0000000000002 (1.1e-13 standard deviations)"),
        (("k", "value"), 1632.01, 0.01, 0.0, None),
        (("k", "value"), 1632.2, 0.01, 0.0,
         "files, fit.json, k, value: 1632.0 -> 1632.2 (0.1 standard deviations)"),
        (("k", "value"), None, 9.0, 9.0, "files, fit.json, k, value: 1632.0 -> None"),
        (("gap",), 5.01, 0.0, 0.01, None),
        (("gap",), 5.01, 9.0, 0.0, "files, fit.json, gap: 5.0 -> 5.01"),
        (("verdict",), "end_stop", 9.0, 9.0, "files, fit.json, verdict: none -> end_stop"),
    ],
)  # fmt: skip
def test_a_change_is_reported_with_its_place(
    path: tuple[Any, ...], value: Any, within: float, relative: float, reported: str | None
) -> None:
    changed: Any = deepcopy(RESULT)
    place = changed if path[0] in RESULT else changed["files"]["fit.json"]
    for key in path[:-1]:
        place = place[key]
    place[path[-1]] = value
    assert list(differences(RESULT, changed, within, relative)) == ([reported] if reported else [])


def test_each_run_that_differs_or_is_missing_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    changed, gone = RESULT | {"exit": 2}, RESULT | {"run": "gap bag"}
    for folder, results in (("before", (RESULT, RESULT, gone)), ("after", (RESULT, changed))):
        (tmp_path / folder).mkdir()
        for number, result in enumerate(results):
            (tmp_path / folder / f"{number}.json").write_text(json.dumps(result), "utf-8")
    assert compare(tmp_path / "before", tmp_path / "after", 0.0) == 2
    assert capsys.readouterr().out.splitlines() == [
        "fit bag: exit: 0 -> 2", f"gap bag: only in {tmp_path / 'before'}", "1 of 3 runs are equal",
    ]  # fmt: skip


def test_what_a_run_cannot_repeat_is_masked_and_results_are_not() -> None:
    kept = {
        "value": 0.31,
        "at": "2025-01-01T12:00:03Z",
        "id": "1735732805009500000",
        "x": "1.2345678901234567e-05",
    }
    volatile = {"elapsed_s": 3.1, "by": "spool 0.9.1 (commit 0123abc+)", "bag": "/x/y/bag 0123456789abcdef"}
    assert masked(kept | volatile, {"/x/y": "OUT"}) == kept | {"by": "VERSION", "bag": "OUT/bag HASH"}


def test_a_page_is_its_text_without_pictures_and_code() -> None:
    page = '<h1>Fit</h1><p>k is <b>3 N</b>.<script>x</script></p><svg><text>9</text></svg><img src="data:x">'
    assert page_text(page) == ["Fit", "k is 3 N.", "[picture]", "[picture]"]


def test_every_command_has_a_run() -> None:
    known = dict(commands(get_command(app)))
    assert {"alarm list", "fleet add", "gap"} <= known.keys()
    assert without_run([*known, "polish"]) == ["polish"]
    assert expanded("a {b|c} d{| e}") == ["a b d", "a b d e", "a c d", "a c d e"]


def test_a_sample_holds_text_files_and_refusals(tmp_path: Path) -> None:
    assert Collection(tmp_path / "out", ROOT).collect("^(simulate --excitation standstill|info missing)") == 0
    results = {one["run"]: one for one in map(content, (tmp_path / "out").glob("*.json"))}
    refused, names = results.pop("info missing"), results.pop("public names")
    (made,) = results.values()
    assert (refused["exit"], len(refused["errors"])) == (2, 1)
    assert (made["exit"], made["files"]["bag/bag_0.mcap"]["/valve_1/acceleration"]["count"]) == (0, 150)
    assert names["python"]["spool.fit"][0].startswith("(")
    assert str(tmp_path) not in json.dumps([refused, names, made])
