"""Fits and gap analyses of one record state the same numbers and intervals for the same model."""

from __future__ import annotations

from pathlib import Path

import pytest
from spool_core.uncertainty import Z_95
from spool_estimator.identification.fit import fit
from spool_estimator.identification.fit_result import FitSettings
from spool_gap.evidence.intervals import refined
from spool_gap.evidence.look import look_at
from spool_gap.likelihood.kernel import motions_for
from spool_gap.likelihood.prediction import Prediction, Predictions
from spool_gap.likelihood.structure import structure_of
from spool_gap.likelihood.structure_fit import fit_structure
from spool_report.records.record_loading import load_recording
from spool_sim.model import MODELS
from spool_sim.valve import find_valve

RECORD = Path(__file__).resolve().parents[4] / "bags" / "practice_03"
COULOMB = MODELS["coulomb"]
#: Two estimates of a deviation from the same 40 s, by windows of 1 s and by blocks of 0.5 s.
AS_WIDE = 1.5


def test_a_fit_and_a_gap_analysis_state_the_same_interval_for_one_model() -> None:
    valve = find_valve("4weh10_soft")
    records = load_recording(RECORD).stretches
    # The gap analysis takes gain and delay of the spool's channel as unknown.
    found = fit(records, COULOMB, valve, FitSettings(fit_gain=True, fit_delay=True))
    (readings,) = look_at(records, (), valve).readings
    predictions = Predictions([Prediction(readings, valve, motions_for(COULOMB))])
    (part,) = predictions.parts
    part.plain = True
    near = fit_structure(predictions, structure_of(COULOMB, valve)).structure
    part.plain = False
    _, numbers = refined(predictions, fit_structure(predictions, near))
    for own in found.parameters[:3]:
        other = numbers.of(own.name)
        assert other is not None
        widths = own.standard_deviation, other.standard_deviation
        assert max(widths) < AS_WIDE * min(widths), own.name
        assert own.value == pytest.approx(other.value, abs=Z_95 * min(widths)), own.name
