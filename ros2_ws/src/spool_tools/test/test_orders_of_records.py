"""`./spool check` and `./spool replay` on a run-up of a machine whose speed is recorded."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from spool_sim.valve import shipped_valves
from spool_tools.cli import main


def test_a_run_up_shows_its_orders_and_resonance_names_the_component(tmp_path: Path) -> None:
    valve, bag, table = tmp_path / "valve.yaml", str(tmp_path / "bag"), str(tmp_path / "bag.csv")
    text = shipped_valves()["4weh10_stiff"].read_text("utf-8")
    valve.write_text(
        text + "components:\n  - {name: pump, pistons: 9}\n  - {name: fan, ratio: 1.8}\n", "utf-8"
    )
    simulated = ["simulate", "--valve", str(valve), "--excitation", "run_up", "--seconds", "40", "--out", bag]
    assert main(simulated) == 0
    assert main(["export", bag, "--out", table]) == 0
    for record in (bag, table):
        found = tmp_path / "found.json"
        main(["check", record, "--json", str(found), "--force"])
        lines = json.loads(found.read_text("utf-8"))["order_lines"]
        assert [round(one["order"], 3) for one in lines] == [1.0, 2.0]
        names = ["pump", "pump"] if record == bag else ["", ""]  # a table has no description of a valve
        assert [one["component"] for one in lines] == names
        assert [one["body"] for one in lines] == pytest.approx([4.0, 6.0], rel=0.02)
        valves = [] if record == bag else ["--valve", str(valve)]
        assert main(["replay", record, *valves, "--json", str(found), "--force"]) == 0
        (one,) = json.loads(found.read_text("utf-8"))["valves"].values()
        event = next(event for event in one["events"] if event["kind"] == "resonance")
        assert event["message"].startswith("Resonance (2nd order of the pump, ")
        speed = event["evidence"]["speed"]["value"]
        assert speed == pytest.approx(600.0 + 10.0 * (event["t_s"] - 10.0), rel=0.01)


@pytest.mark.parametrize(
    ("lines", "wrong"),
    [
        ("  - {name: pump, pistons: 0}", "components.0.pistons"),
        ("  - {name: two words}", "components.0.name"),
        ("  - {name: engine, strokes: 4}", "give both or neither"),
        ("  - {name: engine, strokes: 3, cylinders: 4}", "components.0.strokes"),
        ("  - {name: pump}\n  - {name: pump}", "two components have one name"),
        ("  - {name: pump, speed: 3}", "components.0.speed: unknown key"),
        ("  pump: 9", "components"),
    ],
)
def test_a_wrong_component_is_refused_by_name(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], lines: str, wrong: str
) -> None:
    valve = tmp_path / "valve.yaml"
    valve.write_text(shipped_valves()["4weh10_stiff"].read_text("utf-8") + f"components:\n{lines}\n", "utf-8")
    assert main(["simulate", "--valve", str(valve), "--out", str(tmp_path / "bag")]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert wrong in line
