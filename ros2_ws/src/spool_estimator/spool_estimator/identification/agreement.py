"""Agreement of a model's free run with records: nrmse, objective (33), amplitude ratio, spectrum."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import signal
from spool_sim.model import Model
from spool_sim.sensors import PAPER_CHAIN
from spool_sim.valve.description import Valve

from .fit_result import SPOOL_DELAY, SPOOL_GAIN, Agreement
from .free_run import FreeRun, Response
from .record import Record

Array = NDArray[np.float64]

#: Hz, width of the bands in which amplitudes are compared, and the range that the mean covers.
BAND = 5.0
LOWEST, HIGHEST = 10.0, 100.0
#: A band counts where the measured power is this share of the strongest band's, at least.
SMALLEST_POWER = 1e-4


def free_run_agreement(
    records: Sequence[Record],
    model: Model,
    valve: Valve,
    values: Mapping[str, float],
    *,
    sensor: Mapping[str, float] | None = None,
    run_in: float = 0.5,
    low_cut: float = 3.0,
    compensate_oil: bool = True,
) -> Agreement:
    """Return how ``model`` with ``values`` agrees with ``records``, simulated in one piece each.

    Args:
        records: not necessarily those of a fit.
        model, valve: as in a fit.
        values: all parameters of the model.
        sensor: gain error and delay of the spool's sensor, none by default.
        run_in: s at the start of each record that do not count.
        low_cut: Hz, of the conditioning that gives the motion to start from.
        compensate_oil: use the oil temperature where record and valve give it.

    Raises:
        InputError: no record is long enough.
    """
    run = FreeRun(records, model, valve, run_in=run_in, low_cut=low_cut, compensate_oil=compensate_oil)
    return agreement(run, _responses(run, values, sensor))


@dataclass(frozen=True, slots=True)
class Waveform:
    """Measured motion of one record, and the free run of a model over it; every array has shape (n,).

    Attributes:
        time: s since the start of the recording.
        measured, simulated: acceleration of the spool, m/s^2.
        displacement, velocity: of the free run, relative to the body, m, m/s.
    """

    time: Array
    measured: Array
    simulated: Array
    displacement: Array
    velocity: Array


def waveforms(
    records: Sequence[Record],
    model: Model,
    valve: Valve,
    values: Mapping[str, float],
    *,
    sensor: Mapping[str, float] | None = None,
    run_in: float = 0.5,
) -> list[Waveform]:
    """Return the free run of ``model`` with ``values`` next to what was measured, one for each record.

    Records too short for it have none. Arguments as of :func:`free_run_agreement`; the first ``run_in`` s of
    each record are left out.

    Raises:
        InputError: no record is long enough.
    """
    run = FreeRun(records, model, valve, run_in=run_in)
    found = []
    for window, response in zip(run.windows, _responses(run, values, sensor), strict=True):
        record = run.records[window.record]
        first = record.first_sample + window.start
        found.append(
            Waveform(
                np.asarray(
                    (first + np.arange(window.measured.size)) * record.sample_period, dtype=np.float64
                ),
                window.measured,
                response.acceleration[0],
                response.displacement[0],
                response.velocity[0],
            )
        )
    return found


def _responses(
    run: FreeRun, values: Mapping[str, float], sensor: Mapping[str, float] | None
) -> Sequence[Response]:
    """Return the responses to one set of parameters, with gain error and delay of the spool's sensor."""
    run.choose_substeps(values)
    errors = sensor or {}
    gain, delay = errors.get(SPOOL_GAIN, 0.0), errors.get(SPOOL_DELAY, 0.0)
    return run.responses(run.sets(values), np.array([gain]), np.array([delay]))


def agreement(run: FreeRun, responses: Sequence[Response]) -> Agreement:
    """Return how the first set of ``responses`` agrees with the windows of ``run``.

    Samples are compared, or their means over the sample intervals where those agree better: of a record that
    was band-limited before it was sampled, jumps of friction are smeared, which samples of a model are not.
    """
    measured = [window.measured for window in run.windows]
    simulated = [response.acceleration[0] for response in responses]
    means = [window.measured_means for window in run.windows]
    simulated_means = [response.means[0] for response in responses]
    if _squares(simulated_means, means) < _squares(simulated, measured):
        measured, simulated = means, simulated_means
    errors = [one - other for one, other in zip(simulated, measured, strict=True)]
    squares = _squares(simulated, measured)
    power = float(sum(np.sum(row**2) for row in measured))
    samples = sum(row.size for row in measured)
    sigma = PAPER_CHAIN.relative_uncertainty / np.sqrt(3.0) * np.sqrt(power / samples)
    periods = [run.records[window.record].sample_period for window in run.windows]
    centres, ratios = _amplitude_ratios(simulated, measured, periods)
    inside = (centres >= LOWEST) & (centres <= HIGHEST) & np.isfinite(ratios)
    frequency, density = _residual_spectrum(errors, periods)
    return Agreement(
        nrmse=float(np.sqrt(squares / power)) if power > 0.0 else float("nan"),
        objective=squares / sigma**2 if sigma > 0.0 else float("nan"),
        frequencies=centres,
        amplitude_ratios=ratios,
        amplitude_ratio=float(ratios[inside].mean()) if inside.any() else float("nan"),
        residual_frequencies=frequency,
        residual_spectrum=density,
        seconds=float(sum(row.size * period for row, period in zip(measured, periods, strict=True))),
        samples=samples,
    )


def _squares(simulated: Sequence[Array], measured: Sequence[Array]) -> float:
    return float(sum(np.sum((one - other) ** 2) for one, other in zip(simulated, measured, strict=True)))


def _amplitude_ratios(
    simulated: Sequence[Array], measured: Sequence[Array], periods: Sequence[float]
) -> tuple[Array, Array]:
    """Return the centres of the bands and the ratio of the rms amplitudes in each."""
    highest = min(0.4 / max(periods), 500.0)
    edges = np.arange(0.5 * BAND, highest + BAND, BAND)
    powers = np.zeros((2, edges.size - 1))
    for rows, total in ((simulated, powers[0]), (measured, powers[1])):
        for row, period in zip(rows, periods, strict=True):
            spectrum = np.abs(np.fft.rfft(row * np.hanning(row.size + 2)[1:-1])) ** 2 / row.size
            place = np.digitize(np.fft.rfftfreq(row.size, period), edges) - 1
            good = (place >= 0) & (place < total.size)
            np.add.at(total, place[good], spectrum[good])
    there = powers[1] > SMALLEST_POWER * powers[1].max(initial=0.0)
    ratios = np.full(edges.size - 1, np.nan)
    ratios[there] = np.sqrt(powers[0, there] / powers[1, there])
    return 0.5 * (edges[1:] + edges[:-1]), ratios


def _residual_spectrum(errors: Sequence[Array], periods: Sequence[float]) -> tuple[Array, Array]:
    """Return frequency and power density of the errors, of the records with the shortest period."""
    period = min(periods)
    rows = [row for row, own in zip(errors, periods, strict=True) if own == period]
    piece = min(*(row.size for row in rows), max(16, round(1.0 / period)))
    densities = [signal.welch(row, 1.0 / period, "hann", piece, detrend=False) for row in rows]
    weights = [row.size for row in rows]
    return np.asarray(densities[0][0]), np.asarray(
        np.average([density for _, density in densities], axis=0, weights=weights)
    )
