"""`./spool plan`: what a planned record could tell is what a fit of such a record tells."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from spool_design.record_plan import QUESTIONS, TOLD, Plan, coulomb_friction, travel
from spool_sim.excitation import load_excitation
from spool_sim.model import load_model
from spool_sim.valve import find_valve, valve_from_mapping
from spool_tools.cli import main

STEADY = "kind: steady_sine\nfrequency: 30.0\namplitude: 10.0\n"


def planned(tmp_path: Path, *arguments: str) -> tuple[int, dict[str, Any]]:
    out = tmp_path / "plan.json"
    code = main(
        ["plan", "--seconds", "8", "--sample-rate", "1000", *arguments, "--json", str(out), "--force"]
    )
    return code, json.loads(out.read_text(encoding="utf-8"))


@pytest.mark.parametrize("question", ["viscous_coefficient", "spring_stiffness"])
def test_a_change_is_told_from_196_standard_deviations_of_two_records(tmp_path: Path, question: str) -> None:
    code, found = planned(tmp_path, "--question", question)
    assert code == 0
    one = found["parameters"][question]
    assert one["value"] == pytest.approx(one["truth"], abs=4.0 * one["std"])
    assert found["limit"]["value"] == pytest.approx(1.96 * 2.0**0.5 * one["std"] / one["truth"], rel=1e-3)
    assert found["limit"]["unit"] == "1"


def test_twice_the_noise_tells_half_as_much(tmp_path: Path) -> None:
    """Standard deviations go with the noise: information matrix over its variance."""
    deviations = [
        planned(tmp_path, "--question", "viscous_coefficient", "--noise", noise)[1]["parameters"][
            "viscous_coefficient"
        ]["std"]
        for noise in ("0.1", "0.2")
    ]
    assert deviations[1] / deviations[0] == pytest.approx(2.0, rel=0.25)


def test_the_smallest_friction_is_three_of_its_standard_deviations() -> None:
    plan = Plan(find_valve("4weh10_soft"), load_excitation("sweep"), 8.0, 1000.0, 0.2)
    answer = coulomb_friction(plan)
    assert answer.limit is not None
    assert answer.truth is not None
    (force,) = (one for one in answer.parameters if one.name == "coulomb_force")
    assert answer.truth["coulomb_force"] == answer.limit.value
    # Told, and a step of the search below it no more.
    assert TOLD * force.standard_deviation <= answer.limit.value <= 2.0 * TOLD * force.standard_deviation


def test_a_stop_is_met_as_far_as_the_spool_travels(tmp_path: Path) -> None:
    """Steady vibration: the closed form of the oscillator on a shaking base."""
    shaking = tmp_path / "steady.yaml"
    shaking.write_text(STEADY, encoding="utf-8")
    plan = Plan(find_valve("4weh10_soft"), load_excitation(str(shaking)), 8.0, 1000.0)
    record = plan.record(load_model("fluid"), {}, noisy=False)
    valve, omega = plan.valve, 2.0 * 3.141592653589793 * 30.0
    force = valve.spring_stiffness - valve.moving_mass * omega**2 + 1j * omega * valve.viscous_coefficient
    steady = valve.moving_mass * 10.0 / abs(force)
    assert travel(record.part(4000, 8000)) == pytest.approx(steady, rel=0.02)
    code, found = planned(tmp_path, "--question", "end_stop", "--excitation", str(shaking))
    assert code in (0, 1)
    assert found["limit"]["value"] >= 0.98 * steady


def test_the_range_of_the_sensors_is_twice_the_largest_sample(tmp_path: Path) -> None:
    _, found = planned(tmp_path, "--question", "spring_stiffness")
    peak = max(found["record"]["body_peak"], found["record"]["spool_peak"])
    assert found["record"]["range_g"] * 9.80665 >= 2.0 * peak
    assert found["record"]["range_g"] * 9.80665 <= 5.0 * peak


def test_a_machine_at_rest_tells_nothing(tmp_path: Path) -> None:
    code, found = planned(tmp_path, "--question", "coulomb_friction", "--excitation", "standstill")
    assert code == 1
    assert found["limit"] is None
    assert found["reason"]


def test_mass_and_springs_are_enough_to_plan(tmp_path: Path) -> None:
    file = tmp_path / "least.yaml"
    file.write_text("id: least\nmoving_mass: 0.18\nspring_stiffness: 1632.0\n", encoding="utf-8")
    code, found = planned(tmp_path, "--question", "viscous_coefficient", "--valve", str(file))
    assert code == 0
    least = valve_from_mapping({"id": "least", "moving_mass": 0.18, "spring_stiffness": 1632.0})
    assert found["parameters"]["viscous_coefficient"]["truth"] == least.likely_viscous_coefficient
    assert found["notes"] == ["without the oil's name and temperature, warm oil looks like wear"]


@pytest.mark.slow
def test_the_gap_workflow_names_a_large_friction_of_a_planned_record(tmp_path: Path) -> None:
    code, found = planned(
        tmp_path, "--question", "which_effect", "--effect", "coulomb_friction", "--seconds", "15"
    )
    assert code == 0
    first = found["effects"][0]
    assert (first["id"], first["share"], first["named"]) == ("coulomb_friction", 0.2, True)
    shares = [one["share"] for one in found["effects"]]
    assert shares == sorted(shares, reverse=True)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ([], "--question: name one"),
        (["--recover", "--model", "coulomb"], "were removed: run simulate with another valve file, then fit"),
        (["--question", "colour"], f"known: {', '.join(QUESTIONS)}, which_effect"),
        (["--question", "coulomb_friction", "--seconds", "1"], "record 20 s or more"),
        (["--question", "coulomb_friction", "--seconds", "601"], "plan 600 s or less"),
        (["--question", "coulomb_friction", "--sample-rate", "150"], "cannot hold an excitation of up to"),
        (["--question", "which_effect", "--effect", "spool_delay"], "it is no force; use one of"),
        (["--question", "which_effect", "--effect", "colour"], "unknown effect 'colour'"),
        (["--question", "coulomb_friction", "--valve", "nowhere.yaml"], "no such valve file"),
    ],
)
def test_a_wrong_plan_is_refused_in_one_line(
    capsys: pytest.CaptureFixture[str], arguments: list[str], said: str
) -> None:
    assert main(["plan", *arguments]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert said in error
