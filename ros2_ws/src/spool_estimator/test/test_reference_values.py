"""Reference values of what an estimate derives from its parameters, computed by hand from the equations."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from spool_core.uncertainty import Validity
from spool_estimator.estimator import Learned, _derived

EXACT = 1e-6
#: k = 2000 +- 20 N/m and c = 5 +- 0.1 N s/m with a covariance of 0.5; powers of error, force, body, motion.
LEARNED = Learned(
    values=np.array([2000.0, 5.0, 0.4]),
    covariance=np.array([[400.0, 0.5, 0.0], [0.5, 0.01, 0.0], [0.0, 0.0, 1e-4]]),
    certain=True,
    excited=True,
    settling=False,
    powers=np.array([4e-4, 0.04, 9.0, 4e-6]),
    delay=0.1,
)


def test_frequency_and_damping_follow_from_the_parameters_as_worked_out_by_hand() -> None:
    found = _derived(LEARNED, 0.25)
    # sqrt(2000 / 0.25) / (2 pi); half of it times 20 / 2000
    frequency = found["natural_frequency"]
    assert frequency.value == pytest.approx(14.23525, rel=EXACT)
    assert frequency.standard_deviation == pytest.approx(0.07117627, rel=EXACT)
    # 5 / (2 sqrt(2000 * 0.25)); slopes -0.5 * 0.1118034 / 2000 = -2.795085e-5 and 0.1118034 / 5 = 0.02236068:
    # variance 3.125e-7 + 5e-6 - 2 * 6.25e-7 * 0.5
    damping = found["damping_ratio"]
    assert damping.value == pytest.approx(0.1118034, rel=EXACT)
    assert damping.standard_deviation == pytest.approx(2.165064e-3, rel=EXACT)


def test_sizes_of_the_signals_are_those_worked_out_by_hand() -> None:
    found = _derived(LEARNED, 0.25)
    # sqrt(4e-4 / 0.04), sqrt(9), sqrt(4e-6)
    assert found["residual"].value == pytest.approx(0.1, rel=EXACT)
    assert found["excitation"].value == pytest.approx(3.0, rel=EXACT)
    assert found["relative_displacement"].value == pytest.approx(2e-3, rel=EXACT)
    assert found["residual"].validity is Validity.VALID
    units = [found[name].unit for name in ("natural_frequency", "damping_ratio", "relative_displacement")]
    assert units == ["Hz", "1", "m"]


def test_a_valve_without_drag_has_no_damping_and_its_variance_is_finite() -> None:
    free = _derived(replace(LEARNED, values=np.array([2000.0, 0.0, 0.4])), 0.25)["damping_ratio"]
    assert (free.value, free.standard_deviation) == (0.0, 0.0)
    # Rounding may leave a covariance that no numbers have: 5.3125e-6 - 2 * 6.25e-7 * 5 < 0.
    odd = replace(LEARNED, covariance=np.array([[400.0, 5.0, 0.0], [5.0, 0.01, 0.0], [0.0, 0.0, 1e-4]]))
    assert _derived(odd, 0.25)["damping_ratio"].standard_deviation == 0.0


def test_without_certain_parameters_or_a_force_nothing_is_derived() -> None:
    unsure = _derived(replace(LEARNED, certain=False), 0.25)
    assert unsure["natural_frequency"].validity is unsure["damping_ratio"].validity is Validity.UNKNOWN
    assert np.isnan([unsure["natural_frequency"].value, unsure["damping_ratio"].value]).all()
    assert unsure["residual"].validity is Validity.UNKNOWN
    still = _derived(replace(LEARNED, powers=np.array([0.02, 0.0, np.nan, np.nan])), 0.25)
    assert still["residual"].validity is still["excitation"].validity is Validity.UNKNOWN
