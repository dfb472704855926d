"""The model gap, live: an effect that appears is noticed, analysed on request and recorded."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

from spool_bag.reader import BagReader
from spool_msgs.msg import GapAnalysis, HealthEvent, ModelEstimate
from std_srvs.srv import Trigger

if TYPE_CHECKING:
    from .conftest import System


SERVICE = "/valve_1/estimator/analyse_gap"


def asked(system: System) -> Trigger.Response:
    """Ask for an analysis and return what the node says."""
    return system.call(Trigger, SERVICE, Trigger.Request())


def test_an_effect_is_analysed_on_request_beside_the_stream_and_recorded(
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
    system.until(lambda: estimates.heard and estimates.last.samples >= 12_000, "12 s came", timeout=60.0)
    assert asked(system).success
    busy = asked(system)
    assert not busy.success
    before = estimates.last.samples
    system.until(lambda: answers.heard, "the analysis ends", timeout=120.0)
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
        "parameters: {cubic_coefficient: 8.0e8}\n"
    )
    events = system.listen(HealthEvent, "/valve_1/events", latched=True)
    estimates = system.listen(ModelEstimate, "/valve_1/estimate", latched=True)
    system.start("estimator", period=0.2)
    simulator = system.start("simulator", excitation="multisine", model="fluid", wait_for_subscribers=1)
    tracked = ModelEstimate.STATE_TRACKING
    system.until(
        lambda: sum(message.state == tracked for message in estimates.messages) > 25,
        "what is usual is learned", timeout=60.0,
    )  # fmt: skip
    assert not events.heard
    simulator.end()
    system.start("simulator", excitation="multisine", model=hardening, wait_for_subscribers=1)
    system.until(lambda: events.heard, "the gap is noticed", timeout=60.0)
    assert events.last.kind == "model_gap"
    assert events.last.state == HealthEvent.STATE_RAISED
    assert events.last.quantity.name == "residual"
    assert "something is missing" in events.last.message
