"""The remainder is noise only where it is shown to be: each kind of remainder, and noise of any colour."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache

import numpy as np
import pytest
from spool_core.numbers import Array
from spool_estimator.identification.record import Record
from spool_gap.evidence.decision import Decision, decide
from spool_gap.evidence.held_out import HeldOut
from spool_gap.evidence.look import Look, look_at
from spool_gap.likelihood.kernel import motions_for
from spool_gap.likelihood.prediction import Prediction, Predictions
from spool_gap.likelihood.remainder import BODY, MOTION, patterns_of
from spool_gap.likelihood.search import Search
from spool_gap.likelihood.structure import Values, structure_of
from spool_gap.likelihood.structure_fit import DECISIVE, fit_structure
from spool_gap.report import looks_like
from spool_gap.result import GapSettings
from spool_sim.excitation import Excitation, Multisine, SweptSine
from spool_sim.model import MODELS, Model
from spool_sim.observation import INSTANTS, Observation
from spool_sim.sensors import Sensor
from spool_sim.simulator import Simulator
from spool_sim.terms import term
from spool_sim.valve import find_valve

VALVE = find_valve("4weh10_soft").model_copy(update={"dynamic_viscosity": 0.03})
BASE = MODELS["fluid"]
RATE, SECONDS, NOISE = 1000.0, 12.0, 0.03
EXCITATIONS: dict[str, Excitation] = {
    "multisine": Multisine(low_frequency=8.0, high_frequency=90.0, rms=7.0, seed=2),
    "sweep": SweptSine(start_frequency=6.0, stop_frequency=80.0, duration=4.0, amplitude=9.0),
}
Rows = tuple[Array, Array]
both = pytest.mark.parametrize("excitation", ["multisine", pytest.param("sweep", marks=pytest.mark.slow)])


@lru_cache
def moved(excitation: str, effect: str = "", drag: float = 1.0, **numbers: float) -> Rows:
    """Return body and spool, m/s^2, without noise."""
    quiet, terms = Sensor(noise=0.0), [term(effect)] if effect else []
    parameters = {"viscous_coefficient": drag * VALVE.likely_viscous_coefficient, **numbers}
    simulator = Simulator(
        VALVE, EXCITATIONS[excitation], model=Model("hidden", (*BASE.terms, *terms), {}),
        parameters=parameters, sample_rate=RATE, block_size=50, body_sensor=quiet, spool_sensor=quiet,
    )  # fmt: skip
    blocks = list(simulator.records(SECONDS))
    body, spool = (np.concatenate([getattr(one, name) for one in blocks]) for name in ("body", "spool"))
    return body.astype(np.float64), spool.astype(np.float64)


def drawn(seed: int, count: int, shape: Callable[[Array], Array] = np.ones_like) -> Array:
    """Return normal noise of unit rms with the amplitudes ``shape`` over frequency, Hz."""
    lines = np.fft.rfft(np.random.default_rng(seed).standard_normal(count))
    row = np.fft.irfft(lines * shape(np.maximum(np.fft.rfftfreq(count, 1.0 / RATE), 0.3)), count)
    return np.asarray(row / row.std())


def filtered(row: Array, response: Callable[[Array], Array]) -> Array:
    frequency = np.maximum(np.fft.rfftfreq(row.size, 1.0 / RATE), 0.05)
    return np.asarray(np.fft.irfft(np.fft.rfft(row) * response(frequency), row.size))


def fitted(
    body: Array, spool: Array, effect: str, starts: Sequence[Values]
) -> tuple[Predictions, Search, Look]:
    """Return a search that fitted the base, and ``effect`` from the best of ``starts``, if any."""
    noises = (NOISE * drawn(seed, body.size) for seed in (1, 2))
    record = Record("remainder", 0, 1.0 / RATE, body + next(noises), spool + next(noises))
    look = look_at([record], (), VALVE)
    motions = motions_for(BASE)
    predictions = Predictions([Prediction(look.readings[0], VALVE, motions)])
    search = Search(predictions, structure_of(BASE, VALVE), [])
    search.base = fit_structure(predictions, search.base.structure)
    search.fits = {search.base.structure.key: search.base}
    if effect:
        wider = structure_of(BASE, VALVE, [effect]).read_by(Observation(INSTANTS))
        fits = [fit_structure(predictions, wider.moved(one)) for one in starts]
        search.fits[wider.key] = max(fits, key=lambda one: one.evidence)
        assert search.simplest.structure.effects == (effect,)
    return predictions, search, look


def decided(body: Array, spool: Array, effect: str = "", starts: Sequence[Values] = ()) -> Decision:
    """Return the decision on these fits."""
    predictions, search, look = fitted(body, spool, effect, starts)
    motions = predictions.parts[0].motions
    return decide(predictions, search, look, GapSettings(), motions, HeldOut(predictions, [False]))


def cycling(excitation: str) -> Rows:
    """Return a record whose viscosity cycles by a fifth within it."""
    body, thin = moved(excitation, drag=0.8)
    thick = moved(excitation, drag=1.2)[1]
    share = 0.5 + 0.5 * np.sin(2.0 * np.pi * np.arange(body.size) / RATE / 11.0)
    return body, thin + share * (thick - thin)


def toned(excitation: str) -> Rows:
    body, spool = moved(excitation)
    return body, spool + 0.9 * np.sin(2.0 * np.pi * 225.0 * np.arange(body.size) / RATE)


def wandering(excitation: str) -> Rows:
    """Return a record with a tone whose frequency wanders by 0.8 Hz."""
    body, spool = moved(excitation)
    time = np.arange(body.size) / RATE
    return body, spool + 0.9 * np.sin(2.0 * np.pi * 225.0 * time + 4.0 * np.sin(2.0 * np.pi * time / 5.0))


def coupled(excitation: str) -> Rows:
    """Return a record whose channels have AC coupling with different corners."""
    body, spool = moved(excitation)
    return filtered(body, lambda f: f / (f - 0.5j)), filtered(spool, lambda f: f / (f - 1.0j))


def resonant(excitation: str) -> Rows:
    body, spool = moved(excitation)
    return body, filtered(spool, lambda f: 1.0 + 0.2 * f**2 / (97.0**2 - f**2 + 6j * f))


def dragged(excitation: str) -> Rows:
    return moved(excitation, "quadratic_damping", quadratic_coefficient=60.0)


def bent(excitation: str) -> Rows:
    """Return a record whose spool's sensor has an even harmonic of 1 %."""
    body, spool = moved(excitation)
    return body, spool + 0.01 * spool**2 / spool.std()


@both
@pytest.mark.parametrize(
    ("made", "follows"),
    [
        (cycling, {BODY, "time"}),
        (toned, {"a wave of 225 Hz"}),
        (coupled, {BODY}),
        (resonant, {BODY, MOTION}),
        (dragged, {BODY, MOTION, "speed", "position and speed"}),
        (bent, {MOTION, "position and speed", "position"}),
    ],
)
def test_a_remainder_with_a_pattern_is_unexplained_and_says_what_it_follows(
    made: Callable[[str], Rows], follows: set[str], excitation: str
) -> None:
    found = decided(*made(excitation))
    assert found.unexplained
    assert found.rest.follows in follows
    assert next(iter(found.probabilities)) == "unexplained"


def test_a_tone_whose_frequency_wanders_is_unexplained() -> None:
    found = decided(*wandering("multisine"))
    assert found.unexplained
    assert found.rest.follows.startswith("a wave of 22")


def white(rows: Rows) -> Rows:
    return rows


def pink(rows: Rows) -> Rows:
    """Return ``rows`` with pink noise in both channels, four times the white."""
    noises = (4.0 * NOISE * drawn(seed, rows[0].size, lambda f: f**-0.5) for seed in (3, 4))
    return rows[0] + next(noises), rows[1] + next(noises)


def low_passed(rows: Rows) -> Rows:
    shaped = drawn(5, rows[0].size, lambda f: 1.0 / np.sqrt(1.0 + (f / 30.0) ** 4))
    return rows[0], rows[1] + 22.0 * NOISE * shaped


def narrow(rows: Rows) -> Rows:
    """Return ``rows`` with vibration across the spool's axis, of a mount that resonates."""
    shaped = drawn(6, rows[0].size, lambda f: 1.0 / np.abs(1.0 - (f / 97.0) ** 2 + 0.005j * f / 97.0))
    return rows[0], rows[1] + 10.0 * NOISE * shaped


def across(rows: Rows) -> Rows:
    """Return ``rows`` with vibration across the axis in both channels, from 5 to 200 Hz."""
    shaped = drawn(7, rows[0].size, lambda f: ((f > 5.0) & (f < 200.0)).astype(np.float64))
    return rows[0] + 0.3 * shaped, rows[1] + 0.24 * shaped


@both
@pytest.mark.parametrize("noisy", [white, pink, low_passed, narrow, across])
def test_noise_of_any_colour_and_loudness_is_no_remainder(
    noisy: Callable[[Rows], Rows], excitation: str
) -> None:
    found = decided(*noisy(moved(excitation)))
    assert not found.unexplained
    assert found.effects == ()


@pytest.mark.parametrize(("line", "named"), [(225.0, True), (97.0, False)])
def test_a_periodic_force_keeps_its_phase_and_noise_in_a_narrow_band_does_not(
    line: float, named: bool
) -> None:
    rows = toned("multisine") if named else narrow(moved("multisine"))
    size = {"force_frequency": line, "force_amplitude": 0.03}
    starts = [{**size, "force_phase": one} for one in (-2.0, 0.0, 2.0)]
    found = decided(*rows, "periodic_force", starts)
    assert found.effects == (("periodic_force",) if named else ())
    assert ("periodic_force" in found.refused) is (not named)


def test_windows_with_hits_on_a_stop_hold_no_pattern() -> None:
    start = {"stop_gap": 0.0015, "stop_stiffness": 2e5}
    predictions, search, _ = fitted(*moved("sweep", "end_stop", **start), "end_stop", [start])
    # The sweep passes the resonance in each window but a few.
    assert not any(one.gain > DECISIVE for one in patterns_of(predictions, search.simplest))
    assert any(one.gain > DECISIVE for one in patterns_of(predictions, search.base))


@pytest.mark.parametrize("follows", [BODY, MOTION, "a wave of 225 Hz", "time"])
def test_every_pattern_has_words_for_what_it_may_be(follows: str) -> None:
    assert looks_like(follows) != looks_like("nothing")
