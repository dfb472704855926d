"""What a record must have: sample rate, length, motion; one advice for one record."""

from __future__ import annotations

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from spool_core.errors import InputError
from spool_core.record_limits import LIMITS
from spool_estimator.identification.record import Record
from spool_estimator.record_judgement import (
    LENGTHS,
    Analysis,
    check_samples,
    expected_transfer,
    least_rate,
    shortness,
    slowness,
)
from spool_sim.valve import find_valve

NATURAL = st.floats(LIMITS.slowest_valve, 250.0)
HIGHEST = st.one_of(st.just(0.0), st.floats(1.0, 1000.0))


def advised(text: str) -> float:
    found = re.search(r"sample at (\d+) Hz or more", text)
    assert found is not None
    return float(found[1])


@given(natural=NATURAL, highest=HIGHEST, share=st.floats(0.0, 1.0))
def test_every_analysis_gives_the_same_advice_for_a_record_and_takes_the_advised_rate(
    natural: float, highest: float, share: float
) -> None:
    rate = LIMITS.rate + share * (least_rate(Analysis.SHAPE, natural, highest).rate - LIMITS.rate)
    texts = [slowness(analysis, rate, natural, highest) for analysis in Analysis]
    advice = {advised(text) for text in texts if text}
    assert len(advice) <= 1
    for needed in advice:
        if rate >= 4.0 * natural:  # below, the excitation that is seen is folded
            assert not any(slowness(analysis, needed, natural, highest) for analysis in Analysis)


@pytest.mark.parametrize(
    ("analysis", "needed"), [(Analysis.ESTIMATE, 61.0), (Analysis.GAP, 380.0), (Analysis.SHAPE, 808.0)]
)
def test_rates_follow_from_the_natural_frequency_and_the_excitation(
    analysis: Analysis, needed: float
) -> None:
    # 4 and 25 samples in a period at 15.2 Hz: 60.8 and 380; 8 at 101 Hz.
    assert least_rate(analysis, 15.2, 101.0).rate == needed


def test_a_text_names_the_analysis_its_need_and_the_reason() -> None:
    text = slowness(Analysis.GAP, 300.0, 15.2, 101.0)
    assert "300 Hz is too slow for `gap`, which needs 380 Hz (25 samples in a period" in text


def test_no_analysis_of_any_valve_needs_less_than_streams_and_files_must_have() -> None:
    assert min(least_rate(analysis, LIMITS.slowest_valve).rate for analysis in Analysis) == LIMITS.rate


@given(durations=st.lists(st.floats(0.0, 40.0), max_size=8))
def test_every_analysis_advises_the_same_length_and_takes_it(durations: list[float]) -> None:
    texts = [shortness(analysis, durations) for analysis in Analysis]
    advice = {found[1] for text in texts if (found := re.search(r"record (\d+) s or more", text))}
    assert advice <= {"20"}
    assert not any(shortness(analysis, [20.0]) for analysis in Analysis)


@pytest.mark.parametrize(
    ("analysis", "durations"),
    [
        (Analysis.ESTIMATE, [1.9] * 20),
        (Analysis.GAP, [3.9] * 20),
        (Analysis.GAP, [5.9]),
        (Analysis.SHAPE, [19.0]),
    ],
)
def test_stretches_that_hold_too_little_are_too_short(analysis: Analysis, durations: list[float]) -> None:
    text = shortness(analysis, durations)
    assert text.startswith(f"too short for {analysis.value}")
    assert not shortness(analysis, [*durations, LENGTHS[analysis][1]])


def test_a_body_shaken_at_all_frequencies_alike_is_no_noise_alone() -> None:
    """Nothing stands out of its spectrum, but the spool follows; of noise alone it does not."""
    generator = np.random.default_rng(3)
    body, noise = generator.normal(0.0, 5.0, (2, 12_000))
    frequency = np.maximum(np.fft.rfftfreq(body.size, 1.0 / 400.0), 0.1)
    spool = np.fft.irfft(
        np.fft.rfft(body) * expected_transfer(frequency, find_valve("4weh10_soft")), body.size
    )
    check_samples("white", [Record("white", 0, 1.0 / 400.0, body, spool)])
    with pytest.raises(InputError, match=r"^strange: no excitation"):
        check_samples("strange", [Record("strange", 0, 1.0 / 400.0, noise, spool)])
