"""Record of what users get: what changed is reported in the user's words, what differs by rule is not."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from typer.main import get_command

from tests.same.collecting import Collection, masked, without_run
from tests.same.public import commands
from tests.same.reading import content, page_text
from tests.same_numbers import ROOT, compare

COMMAND = "fit bag --model coulomb"
RESULT = {
    "exit": 0, "text": ["coulomb fitted to bag", "force 0.312 N"],
    "files": {"fit.json": {"k": {"value": 1632.0, "std": 2.0}, "gap": 5.0, "verdict": "none"}},
}  # fmt: skip


@pytest.mark.parametrize(
    ("path", "value", "allowed", "reported"),
    [
        (("exit",), 0, {}, ""),
        (("exit",), 1, {}, "exit: 0 -> 1"),
        (("text", 1), "force 0.313 N", {}, "text, line 2: 'force 0.312 N' -> 'force 0.313 N'"),
        (("text", 1), "force 0.313 N", {"relative": 0.01}, ""),
        (("text", 1), "force 0.313 kN", {"relative": 0.01}, "'force 0.313 kN'"),
        (("text", 0), "", {}, "text, line 1: 'coulomb fitted to bag' -> ''"),
        (("files", "fit.json", "k", "value"), 1632.0000000000002, {}, "k, value: 1632.0 -> 1632.00"),
        (("files", "fit.json", "k", "value"), 1632.01, {"within": 0.01}, ""),
        (("files", "fit.json", "k", "value"), 1632.2, {"within": 0.01}, "(0.1 standard deviations)"),
        (("files", "fit.json", "k", "value"), None, {"within": 0.01}, "1632.0 -> None"),
        (("files", "fit.json", "gap"), 5.01, {"relative": 0.01}, ""),
        (("files", "fit.json", "gap"), 5.01, {"within": 0.01}, "fit.json, gap: 5.0 -> 5.01"),
        (("files", "fit.json", "verdict"), "end_stop", {"within": 9.0, "relative": 9.0}, "none -> end_stop"),
    ],
)  # fmt: skip
def test_a_change_is_reported_with_its_command_and_place(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    path: tuple[Any, ...],
    value: Any,
    allowed: dict[str, float],
    reported: str,
) -> None:
    changed = place = json.loads(json.dumps(RESULT))
    for key in path[:-1]:
        place = place[key]
    place[path[-1]] = value
    for folder, content_ in (("before", RESULT), ("after", changed)):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "a.json").write_text(json.dumps({"run": COMMAND, **content_}))
    within, relative = allowed.get("within", 0.0), allowed.get("relative", 0.0)
    assert compare(tmp_path / "before", tmp_path / "after", within, relative) == bool(reported)
    printed = capsys.readouterr().out
    assert f"{1 - bool(reported)} of 1 runs are equal" in printed
    assert (
        any(line.startswith(f"{COMMAND}: ") and reported in line for line in printed.splitlines())
        or not reported
    )


def test_a_run_that_is_missing_is_reported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "a.json").write_text(json.dumps({"run": COMMAND, **RESULT}))
    assert compare(tmp_path, tmp_path / "after", 0.0) == 1
    assert f"{COMMAND}: only in" in capsys.readouterr().out


def test_what_a_run_cannot_repeat_is_masked_and_results_are_not() -> None:
    kept = {"value": 0.31, "at": "2025-01-01T12:00:03Z", "limit": {"key": "limit", "value": "1.8"}}
    told = masked(
        kept
        | {
            "elapsed_s": 3.1,
            "by": "0.9.1 (commit 0123abc+)",
            "bag": "/x/y/bag",
            "p": {"name": "port", "value": "7"},
        },
        {"/x/y": "OUT"},
    )
    assert told == kept | {"by": "VERSION", "bag": "OUT/bag", "p": {"name": "port"}}


def test_a_page_is_its_text_without_pictures_and_code() -> None:
    page = '<h1>Fit</h1><p>k is <b>3 N</b>.<script>x</script></p><svg><text>9</text></svg><img src="data:x">'
    assert page_text(page) == ["Fit", "k is 3 N.", "[picture]", "[picture]"]


def test_every_command_has_a_run() -> None:
    from spool_tools.cli import app  # noqa: PLC0415 - slow to load

    known = dict(commands(get_command(app)))
    assert {"alarm list", "fleet add", "gap"} <= known.keys()
    assert without_run(known) == []
    assert without_run([*known, "polish"]) == ["polish"]


def test_a_sample_holds_text_files_and_refusals(tmp_path: Path) -> None:
    collection = Collection(tmp_path / "out", ROOT)
    assert collection.collect("^(simulate --excitation standstill|info missing)") == 0
    results = {one["run"]: one for one in map(content, (tmp_path / "out").glob("*.json"))}
    refused, names = results["info missing"], results["public names"]
    assert (refused["exit"], len(refused["errors"])) == (2, 1)
    made = next(one for run, one in results.items() if run.startswith("simulate"))
    topic = made["files"]["bag/bag_0.mcap"]["/valve_1/acceleration"]
    assert (made["exit"], topic["count"]) == (0, 150)
    assert str(tmp_path) not in json.dumps(results)
    assert names["python"]["spool.fit"][0].startswith("(")
