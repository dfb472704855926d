"""Search and decision on short records: moves, choice, what is named, how sure it is, how wide intervals are.

Nothing is compiled that the set-up does not compile: the loop for changes of the search.
"""

from __future__ import annotations

import math
from copy import copy
from dataclasses import dataclass, replace
from functools import lru_cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from spool_estimator.identification.record import records_from_blocks
from spool_gap.evidence import decision as decision_module
from spool_gap.evidence import intervals
from spool_gap.evidence.decision import (
    BEYOND,
    OUTSIDE,
    RIGHTLY_UNEXPLAINED,
    Decision,
    decide,
    probabilities_of,
)
from spool_gap.evidence.held_out import HeldOut, Judged
from spool_gap.evidence.intervals import Numbers, numbers_of
from spool_gap.evidence.look import Look, look_at
from spool_gap.likelihood.kernel import motions_for
from spool_gap.likelihood.prediction import Prediction, Predictions
from spool_gap.likelihood.remainder import BODY
from spool_gap.likelihood.rest import Rest
from spool_gap.likelihood.search import Search
from spool_gap.likelihood.structure import DELAY, GAIN, structure_of
from spool_gap.likelihood.structure_fit import DECISIVE, StructureFit, fit_structure
from spool_gap.result import GapSettings
from spool_sim.excitation import SweptSine
from spool_sim.model import MODELS, Model
from spool_sim.sensors import Sensor
from spool_sim.simulator import Simulator
from spool_sim.terms import term
from spool_sim.valve import find_valve

VALVE = find_valve("4weh10_soft").model_copy(update={"dynamic_viscosity": 0.03})
BASE = MODELS["fluid"]
MOTIONS = motions_for(BASE)
RATE, SECONDS, NOISE = 500.0, 6.0, 0.03
SWEEP = SweptSine(start_frequency=6.0, stop_frequency=60.0, duration=3.0, amplitude=9.0)


@dataclass(frozen=True, slots=True)
class Fitted:
    """A short record, to which nothing but the base is fitted."""

    predictions: Predictions
    search: Search
    look: Look

    def decided(self, look: Look | None = None, **settings: float) -> Decision:
        """Return the decision with ``settings``, and with another ``look`` than the record's own."""
        chosen, held = GapSettings(**settings), HeldOut(self.predictions, [False])
        return decide(self.predictions, self.search, look or self.look, chosen, MOTIONS, held)


def fitted(effect: str = "", spool: Sensor | None = None, **given: float) -> Fitted:
    terms = [term(effect)] if effect else []
    simulator = Simulator(
        VALVE, SWEEP, model=Model("hidden", (*BASE.terms, *terms), {}), parameters=given,
        sample_rate=RATE, block_size=50, seed=5,
        body_sensor=Sensor(noise=NOISE), spool_sensor=spool or Sensor(noise=NOISE),
    )  # fmt: skip
    (record,) = records_from_blocks(simulator.records(SECONDS), "short")
    look = look_at([record], (), VALVE)
    predictions = Predictions([Prediction(look.readings[0], VALVE, MOTIONS)])
    search = Search(predictions, structure_of(BASE, VALVE), [])
    assert not predictions.parts[0].plain  # although the record is as short as its excerpts
    search.base = fit_structure(predictions, search.base.structure)
    search.fits = {search.base.structure.key: search.base}
    return Fitted(predictions, search, look)


@lru_cache
def chain() -> Fitted:
    """Return a record whose spool's channel reads 9 % too much, 1 ms late."""
    return fitted(spool=Sensor(noise=NOISE, gain_error=0.09, delay_samples=0.5))


@lru_cache
def drag() -> Fitted:
    """Return a record with drag that the base lacks."""
    return fitted("quadratic_damping", quadratic_coefficient=20.0)


@pytest.mark.parametrize(("name", "setting"), [(GAIN, "gain_tolerance"), (DELAY, "delay_tolerance")])
@pytest.mark.parametrize(("deviations", "named"), [(BEYOND - 0.5, False), (BEYOND + 0.5, True)])
def test_gain_or_delay_is_named_once_it_exceeds_its_tolerance_by_two_deviations(
    name: str, setting: str, deviations: float, named: bool
) -> None:
    found = chain().decided().numbers.of(name)
    assert found is not None
    tolerance = found.value - deviations * found.standard_deviation
    assert (name in chain().decided(**{setting: tolerance}).effects) is named


@pytest.mark.parametrize(("clips", "named"), [("body", (DELAY,)), ("spool", (GAIN, DELAY))])
def test_no_gain_error_is_named_where_the_body_s_channel_clips(clips: str, named: tuple[str, ...]) -> None:
    """A curve restores what the body did meanwhile, and says nothing about a gain."""
    assert chain().decided(replace(chain().look, limits={clips: 16.0})).effects == named


def leave(monkeypatch: pytest.MonkeyPatch, left: float) -> None:
    """Let free runs leave ``left`` times what noise does."""
    judged = HeldOut.judged

    def leaving(held: HeldOut, fit: StructureFit, *, refitted: bool = True) -> Judged:
        found = judged(held, fit, refitted=refitted)
        return replace(found, floor=found.agreement.nrmse / left)

    monkeypatch.setattr(HeldOut, "judged", leaving)


@pytest.mark.parametrize(
    ("gain", "share", "left", "unexplained"),
    [
        (1e4, 0.05, 1.1, True),
        (1e4, 0.05, 0.9, False),
        (1e4, 0.0024, 1.1, False),
        (0.9 * DECISIVE, 0.05, 1.1, False),
    ],
    ids=["more than noise is left", "a free run leaves noise alone", "too small", "not decided"],
)
def test_a_remainder_is_unexplained_where_it_is_certain_large_and_seen_in_a_free_run(
    monkeypatch: pytest.MonkeyPatch, gain: float, share: float, left: float, unexplained: bool
) -> None:
    leave(monkeypatch, left)
    monkeypatch.setattr(decision_module, "rest_of", lambda *_: Rest(gain, share, "speed"))
    monkeypatch.setattr(decision_module, "patterns_of", lambda *_: [])
    found = drag().decided()
    assert found.unexplained is unexplained
    assert (next(iter(found.probabilities)) == "unexplained") is unexplained


@pytest.mark.parametrize(
    ("gain", "share", "left", "unexplained"),
    [
        (1e3, 0.02, 0.03, False),
        (1e3, 0.02, 0.025, True),
        (1e3, 0.0024, 0.003, False),
        (0.9 * DECISIVE, 0.5, 0.5, False),
        (1e3, 0.03, 0.1, True),
    ],
    ids=["quieter than the noise", "louder", "too small", "by chance", "louder than the floor"],
)
def test_a_pattern_is_unexplained_where_chance_is_ruled_out_and_noise_does_not_cover_it(
    monkeypatch: pytest.MonkeyPatch, gain: float, share: float, left: float, unexplained: bool
) -> None:
    judged = HeldOut.judged

    def leaving(held: HeldOut, fit: StructureFit, *, refitted: bool = True) -> Judged:
        found = judged(held, fit, refitted=refitted)
        return replace(found, floor=0.025, agreement=replace(found.agreement, nrmse=left))

    monkeypatch.setattr(HeldOut, "judged", leaving)
    monkeypatch.setattr(decision_module, "rest_of", lambda *_: Rest(0.0, 0.0, "nothing"))
    monkeypatch.setattr(decision_module, "patterns_of", lambda *_: [Rest(gain, share, BODY)])
    found = chain().decided()
    assert (found.unexplained, found.rest.follows == BODY) == (unexplained, unexplained)


@pytest.mark.parametrize(("widened", "named"), [(1.0, ("quadratic_damping",)), (1e3, ())])
def test_a_name_whose_numbers_may_all_be_zero_is_no_name(
    monkeypatch: pytest.MonkeyPatch, widened: float, named: tuple[str, ...]
) -> None:
    def wide(predictions: Predictions, fit: StructureFit) -> Numbers:
        found = numbers_of(predictions, fit)
        rows = [replace(one, standard_deviation=widened * one.standard_deviation) for one in found.quantities]
        return replace(found, quantities=tuple(rows))

    known = drag()
    start = known.search.base.structure.having(("quadratic_damping",), (), {"quadratic_coefficient": 20.0})
    fit = fit_structure(known.predictions, start)
    search = copy(known.search)
    search.fits = {**known.search.fits, start.key: fit}
    monkeypatch.setattr(intervals, "numbers_of", wide)
    found = replace(known, search=search).decided()
    assert found.effects == named
    assert ("quadratic_damping" in found.refused) is (not named)
    # What the name explained is there all the same.
    assert found.unexplained is (not named)


def test_no_verdict_is_surer_than_the_share_of_records_that_some_structure_fits() -> None:
    found = chain().decided()
    assert found.probabilities["none"] > 0.999
    assert found.confidence == pytest.approx(1.0 - OUTSIDE, abs=1e-3)
    doubted = replace(found, probabilities={"none": 0.7, "unexplained": 0.3})
    assert doubted.confidence == pytest.approx(0.7 * (1.0 - OUTSIDE))
    assert replace(doubted, unexplained=True).confidence == pytest.approx(0.3 * RIGHTLY_UNEXPLAINED)


def test_the_pulls_of_a_window_are_those_of_its_real_and_imaginary_lines() -> None:
    """By hand: two parts of two windows, whose pulls are 1, -1, 2 and 0."""
    parts = [SimpleNamespace(inside=np.ones(2, np.bool_), lines=np.arange(3.0)) for _ in range(2)]
    predictions: Any = SimpleNamespace(parts=parts)
    residual = np.zeros((2, 2, 2, 3))  # part, real and imaginary, window, line
    residual[0, 0, 0, 0], residual[0, 1, 1, 2] = 1.0, -1.0
    residual[1, :, 0, 1] = 1.0
    assert [residual.ravel()[one].sum() for one in intervals._windows(predictions)] == [1.0, -1.0, 2.0, 0.0]


def test_an_interval_reaches_to_what_the_record_does_not_tell_apart() -> None:
    known = drag()
    numbers = numbers_of(known.predictions, known.search.base)
    value = known.search.base.structure.values["spring_stiffness"]
    other = replace(
        known.search.base, structure=known.search.base.structure.moved({"spring_stiffness": value + 30.0})
    )
    wider = numbers.united([known.search.base, other]).deviations
    own = numbers.deviations
    assert wider["spring_stiffness"] == pytest.approx(math.hypot(own["spring_stiffness"], 30.0))
    assert wider["viscous_coefficient"] == pytest.approx(own["viscous_coefficient"])
    assert numbers.united([]).deviations == pytest.approx(own)


@pytest.mark.parametrize(("corner", "named"), [(0.0, True), (4.4e-3, False)])
def test_a_delay_that_makes_up_for_a_low_pass_is_no_delay(corner: float, named: bool) -> None:
    """By a Butterworth's slope of phase a low-pass whose corner is 1 over 4.4 ms delays by about 1 ms."""
    known = chain()
    numbers = numbers_of(known.predictions, known.search.base)
    delay = numbers.of(DELAY)
    assert delay is not None
    assert delay.value == pytest.approx(1e-3, rel=0.1)
    own = known.search.base.structure.having((), ("body_anti_alias",), {"body_filter_time": corner})
    found = decision_module._of_the_channel(own, numbers, known.look, GapSettings())
    assert (DELAY in found) is named


@pytest.mark.parametrize(
    ("hit", "left", "unexplained"), [(True, 3.0, True), (False, 3.0, False), (True, 1.1, False)]
)
def test_where_the_spool_hits_something_what_is_left_is_no_noise(
    monkeypatch: pytest.MonkeyPatch, hit: bool, left: float, unexplained: bool
) -> None:
    leave(monkeypatch, left)
    monkeypatch.setattr(decision_module, "patterns_of", lambda *_: [])
    monkeypatch.setattr(decision_module, "rest_of", lambda *_: Rest(0.0, 0.0, "nothing"))
    search = copy(drag().search)
    search.hit = hit
    found = replace(drag(), search=search).decided()
    assert found.unexplained is unexplained
    assert (found.rest.follows == decision_module.BLOWS) is unexplained


def test_what_an_effect_adds_by_chance_takes_no_probability_from_the_set_without_it() -> None:
    """Another law as likely does: evidence between laws that are both a little wrong tells little."""
    evidence = {"a": 0.0, "a+b": -1.0, "c": -1.0}
    held = probabilities_of(evidence, "a", held=frozenset({"a"}))
    assert held["a+b"] < 1e-4
    assert held["c"] > 0.1
    assert held["a"] == pytest.approx(1.0 - held["c"], abs=1e-4)
    without = probabilities_of(evidence, "a")
    assert without["a+b"] == pytest.approx(without["c"])


def searched(*names: str, **given: Any) -> Search:
    """Return a search for effects in a record with drag that the base lacks, after its end."""
    every = fitted("quadratic_damping", quadratic_coefficient=20.0).predictions
    search = Search(every, structure_of(BASE, VALVE), names, **given)
    search.run()
    return search


@lru_cache
def ended() -> tuple[Search, list[tuple[str, float]]]:
    """Return such a search, and what it said on its way."""
    said: list[tuple[str, float]] = []
    tell = lambda what, share: said.append((what, share))  # noqa: E731
    return searched("cubic_stiffness", "quadratic_damping", tell=tell), said


def test_the_search_ends_at_the_drag_beside_which_the_remainder_follows_nothing() -> None:
    search, _ = ended()
    assert search.simplest.structure.effects == ("quadratic_damping",)
    assert search.simplest.structure.values["quadratic_coefficient"] == pytest.approx(20.0, rel=0.03)
    tried = {effects for effects, _ in search.fits}
    assert tried == {frozenset(), frozenset({"cubic_stiffness"}), frozenset({"quadratic_damping"})}


def test_the_progress_of_a_search_only_rises() -> None:
    shares = [share for _, share in ended()[1]]
    assert len(shares) >= 4
    assert shares == sorted(shares)
    assert shares[0] > 0.0
    assert shares[-1] < 1.0


def test_a_search_without_work_left_tries_no_pair() -> None:
    search = searched("cubic_stiffness", "quadratic_damping", allowed=0.0)
    assert search.late
    assert search.simplest.structure.effects == ("quadratic_damping",)
    assert max(len(effects) for effects, _ in search.fits) == 1


@pytest.mark.parametrize(
    ("name", "ahead", "fall", "static_force", "chosen"),
    [
        ("quadratic_damping", 9.0, 0.0, 0.0, False),
        ("quadratic_damping", 11.0, 0.0, 0.0, False),
        ("quadratic_damping", 11.0, 0.02, 0.0, True),
        ("stribeck_friction", 11.0, 0.02, 0.5, True),
        ("stribeck_friction", 11.0, 0.02, 0.4, False),
    ],
    ids=[
        "not decisive",
        "hardly less remains",
        "decisive",
        "sensible",
        "friction that does not fall with speed",
    ],
)
def test_a_richer_fit_counts_where_the_evidence_decides_for_it_and_its_numbers_make_sense(
    name: str, ahead: float, fall: float, static_force: float, chosen: bool
) -> None:
    search = copy(ended()[0])
    base = search.base
    own = {"quadratic_coefficient": 20.0, "coulomb_force": 0.4, "static_force": static_force}
    wider = base.structure.having((name,), ())
    wider = wider.moved({key: value for key, value in own.items() if key in wider.values})
    # One number more costs half the logarithm of the count of samples.
    likelihood = base.log_likelihood + ahead + fall * base.numbers + 0.5 * math.log(base.numbers)
    richer = replace(base, structure=wider, count=base.count + 1, log_likelihood=likelihood)
    search.fits = {one.structure.key: one for one in (richer, base)}
    assert search.simplest.structure.effects == ((name,) if chosen else ())
