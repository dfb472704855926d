"""Needs of each analysis: least sample rate, by the valve and its excitation, and least length of a record.

A rate is a number of samples in a period, of the valve's natural frequency or of the highest frequency
excited. Two samples in a period are the sampling theorem's limit; each analysis needs more, for its reason.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Sequence
from typing import NamedTuple

#: Hz, a third of the natural frequency of the softest valve described here: no spool on springs is slower.
SLOWEST_VALVE = 5.0
#: Samples in a period of the natural frequency that an estimate needs: twice the sampling theorem's, since
#: the anti-aliasing filter of a data logger takes the octave above.
OF_ESTIMATE = 4.0
#: The same of the gap workflow: steps of friction and contacts are located within a period (chosen on blind
#: cases other than the published ones); and in one of the highest frequency excited, with room for a filter.
OF_GAP, OF_GAP_EXCITED = 25.0, 3.0
#: Samples in a period of the highest frequency excited for narrow intervals: the third harmonic of
#: a step of friction lies below half the rate. Below, those of friction were ten times as wide (simulated).
OF_SHAPE = 8.0

#: Hz: what nothing can be estimated from, of any valve; streams, bags and files below it are refused.
LEAST_RATE = OF_ESTIMATE * SLOWEST_VALVE


class Analysis(enum.Enum):
    """Work that needs a least sample rate; the value is the text people read."""

    ESTIMATE = "an estimate"
    GAP = "`gap`"
    SHAPE = "narrow intervals"


class Need(NamedTuple):
    """Least rate (Hz) that an analysis needs, and the reason."""

    rate: float
    reason: str


class Length(NamedTuple):
    """Least length of a record: ``total`` s in stretches without gaps of ``stretch`` s or more."""

    stretch: float
    total: float
    reason: str


#: Lengths by the parts they must hold: one fit, not validated; windows of 4 s, which settle first; enough
#: periods of the slowest excitation in use to separate friction from noise.
LENGTHS = {
    Analysis.ESTIMATE: Length(2.0, 2.0, "the filters settle, the model runs in, and something is fitted"),
    Analysis.GAP: Length(4.0, 6.0, "windows to fit and to hold out"),
    Analysis.SHAPE: Length(4.0, 20.0, "20 periods at 1 Hz"),
}


def least_rate(analysis: Analysis, natural_frequency: float, highest: float = 0.0) -> Need:
    """Return the least sample rate of an analysis.

    Args:
        analysis: what the samples are for.
        natural_frequency: of the valve, Hz; 0: unknown.
        highest: frequency of the excitation, Hz; 0: unknown.
    """
    natural = f"a period of the natural frequency, {natural_frequency:.3g} Hz"
    excited = f"a period of the highest frequency excited, {highest:.3g} Hz"
    of_natural = Need(math.ceil(OF_ESTIMATE * natural_frequency), f"{OF_ESTIMATE:g} samples in {natural}")
    of_gap = max(
        Need(math.ceil(OF_GAP * natural_frequency), f"{OF_GAP:g} samples in {natural}"),
        Need(math.ceil(OF_GAP_EXCITED * highest), f"{OF_GAP_EXCITED:g} samples in {excited}"),
    )
    if analysis is Analysis.ESTIMATE:
        return of_natural
    if analysis is Analysis.GAP:
        return of_gap
    return max(of_gap, Need(math.ceil(OF_SHAPE * highest), f"{OF_SHAPE:g} samples in {excited}"))


def slowness(analysis: Analysis, sample_rate: float, natural_frequency: float, highest: float = 0.0) -> str:
    """Return that ``sample_rate`` (Hz) is too low for an analysis and the rate to choose; "" where it is not.

    The rate to choose serves every analysis: all commands give the same advice for a record.
    """
    need = least_rate(analysis, natural_frequency, highest)
    if sample_rate >= need.rate:
        return ""
    if sample_rate < OF_ESTIMATE * natural_frequency:
        highest = 0.0  # the resonance may be folded: what is seen of the excitation is, too
    best = least_rate(Analysis.SHAPE, natural_frequency, highest)
    needs = f"{analysis.value}, which needs {need.rate:.0f} Hz ({need.reason})"
    if best == need:
        needs = f"{analysis.value} ({need.reason})"
    advice = f"sample at {best.rate:.0f} Hz or more"
    reason = "" if best == need else f" ({best.reason}), by which every analysis is served"
    return f"{sample_rate:.6g} Hz is too slow for {needs}: {advice}{reason}"


def shortness(analysis: Analysis, durations: Sequence[float]) -> str:
    """Return that stretches (s, between gaps) are too short for an analysis; "" where they are not.

    As with the rate, the length to choose serves every analysis.
    """
    need, best = LENGTHS[analysis], LENGTHS[Analysis.SHAPE]
    if sum(one for one in durations if one >= need.stretch) >= need.total:
        return ""
    needs = f", which needs {need.total:g} s ({need.reason})"
    reason = f" ({best.reason}), by which every analysis is served"
    return (
        f"too short for {analysis.value}{needs if need != best else ''}: {sum(durations):.3g} s, the longest "
        f"stretch without gaps {max(durations, default=0.0):.3g} s: record {best.total:g} s or more{reason}"
    )
