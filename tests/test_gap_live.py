"""The model gap, live: an effect that appears is noticed, analysed on request and recorded."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from spool_bag.reader import BagReader
from spool_msgs.msg import GapAnalysis, HealthEvent, ModelEstimate, WindowRefit
from spool_sim.model import load_model
from spool_tools.cli import main
from std_srvs.srv import Trigger

if TYPE_CHECKING:
    from .conftest import System


SERVICE = "/valve_1/estimator/analyse_gap"


def asked(system: System) -> Trigger.Response:
    """Ask for an analysis and return what the node says."""
    return system.call(Trigger, SERVICE, Trigger.Request())


@pytest.mark.slow
def test_an_effect_is_analysed_on_request_next_to_the_stream_and_recorded(
    system: System, tmp_path: Path
) -> None:
    bag = tmp_path / "bag"
    answers = system.listen(GapAnalysis, "/valve_1/gap", latched=True)
    estimates = system.listen(ModelEstimate, "/valve_1/estimate", latched=True)
    recorder = system.start("recorder", namespace="", output=bag, valves="[valve_1]")
    estimator = system.start("estimator", gap_window=12.0)
    early = asked(system)
    assert not early.success
    assert "no samples" in early.message
    simulator = system.start("simulator", excitation="multisine", coulomb_force=0.4, wait_for_subscribers=2)
    system.until(lambda: estimates.heard and estimates.last.samples >= 12_000, "12 s came")
    assert asked(system).success
    busy = asked(system)
    assert not busy.success
    before = estimates.last.samples
    system.until(lambda: answers.heard, "the analysis ends")
    assert estimates.last.samples > before
    found = answers.last
    assert found.state == GapAnalysis.STATE_DONE
    assert found.verdict == "coulomb_friction", found.sentence
    assert 0.5 < found.confidence.value <= 1.0
    whole = json.loads(found.json)
    assert whole["effects"][0]["parameters"]["coulomb_force"]["value"] > 0.3
    for process in (simulator, estimator, recorder):
        assert process.end() == 0
    assert BagReader(bag).topics["/valve_1/gap"].messages == 1


def test_a_gap_that_opens_raises_its_event(system: System, tmp_path: Path) -> None:
    hardening = tmp_path / "hardening.yaml"
    hardening.write_text(
        "name: hardening\nterms: [inertia, spring, viscous_friction, cubic_stiffness]\n"
        "parameters: {cubic_coefficient: 8.0e8}\n",
        "utf-8",
    )
    events = system.listen(HealthEvent, "/valve_1/events", latched=True)
    estimates = system.listen(ModelEstimate, "/valve_1/estimate", latched=True)
    system.start("estimator", period=0.2, memory=1.0)
    simulator = system.start("simulator", excitation="multisine", model="fluid", wait_for_subscribers=1)
    tracked = ModelEstimate.STATE_TRACKING
    system.until(
        lambda: sum(message.state == tracked for message in estimates.messages) > 25,
        "what is normal is learned",
    )
    assert not events.heard
    simulator.end()
    system.start("simulator", excitation="multisine", model=hardening, wait_for_subscribers=1)
    system.until(lambda: events.heard, "the gap is noticed")
    raised = events.last
    assert raised.kind == "model_gap"
    assert raised.state == HealthEvent.STATE_RAISED
    assert raised.quantity.name == "residual"
    assert raised.message.startswith("Model gap: unexplained force ")
    assert raised.value > raised.limit > raised.baseline


@pytest.mark.slow
def test_the_model_that_was_found_runs_in_simulator_and_estimator(
    system: System, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    found = tmp_path / "found.yaml"
    record = str(Path(__file__).resolve().parent.parent / "bags" / "practice_03")
    assert main(["gap", record, "--valve", "4weh10_soft", "--stop", "20", "--save-model", str(found)]) == 0
    assert "coulomb_friction" in capsys.readouterr().out
    truth = load_model(found).values
    estimates = system.listen(ModelEstimate, "/valve_1/estimate", latched=True)
    refits = system.listen(WindowRefit, "/valve_1/refit", latched=True)
    answers = system.listen(GapAnalysis, "/valve_1/gap", latched=True)
    system.start("estimator", gap_base=found, gap_window=12.0, refit_model=found, refit_period=6.0)
    system.start("simulator", excitation="multisine", model=found, wait_for_subscribers=1)
    system.until(lambda: estimates.heard and estimates.last.samples >= 24_000, "12 s came")
    system.until(lambda: refits.heard, "a window is refitted")
    seen = {one.name: one.value for one in estimates.last.parameters}
    assert estimates.last.state == ModelEstimate.STATE_TRACKING
    assert seen["spring_stiffness"] == pytest.approx(truth["spring_stiffness"], rel=0.02)
    assert seen["coulomb_force"] == pytest.approx(truth["coulomb_force"], rel=0.05)
    refit = {one.name: one.value for one in refits.last.parameters}
    assert refits.last.model == load_model(found).name
    assert refit["coulomb_force"] == pytest.approx(truth["coulomb_force"], rel=0.05)
    # What was found is in the base now, so nothing is missing any more.
    assert asked(system).success
    system.until(lambda: answers.heard, "the analysis ends")
    assert answers.last.verdict == "none", answers.last.sentence
