"""Verdict: what is named, how sure that is, and when nothing is named."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
from spool_core.uncertainty import Quantity, Validity
from spool_estimator.identification.nuisances.hum import MAINS, STRAY, Hum
from spool_estimator.identification.nuisances.record_nuisance import Nuisance

from spool_gap.checks.saturation import Saturation
from spool_gap.fitting.descent import Fitted
from spool_gap.fitting.hypothesis import Hypothesis
from spool_gap.registry import CHAIN, EFFECTS
from spool_gap.result import RankedHypothesis, Remainder
from spool_gap.screening.remainder import PredictableShares
from spool_gap.selection.state import SelectionState
from spool_gap.simulation.jitter import Jitter, sampling_jitter
from spool_gap.simulation.noise_floor import Floor
from spool_gap.thresholds import THRESHOLDS

from .confidence import Confidence, calibrated, logarithm
from .importance import share_of
from .residual import FinalResidual, residue_of
from .sentence import missing_nothing, named, still_missing, unnamed

#: Names whose residual power is below this many noise floors where clipped samples are all that is named.
CLIPPED_MAY_LEAVE = 3.0


#: Share of the gap's power that names must explain to stay where something else is left. One that explains
#: less is a start value of what is missing rather than a part of it.
EXPLAINS = 0.1
#: Error of the base over the noise floor from which the gap is larger than noise: half of its power or more.
LARGER = 1.5
#: Share of the gap's power that names must explain where the body's channel clips: the errors of its restored
#: tops make most of the gap there, and any force that is fitted takes some of them.
MOST_OF_IT = 0.5
#: Power of what is left over the white noise's from which noise is called coloured: the density of white
#: noise is known to some 10 %, that of the residual to some 20 %.
COLOURED = 2.0
#: Confidence at most where the channels may not be of one valve: even that they are is doubted.
DOUBTFUL = 0.3
#: Importance of a verdict without names that have one: that of a large effect.
IMPORTANT = 1.0
#: What to look at.
CHECK_CLIPPING = "measuring range against the largest acceleration, amplifier setting"
CHECK_JITTER = "the clock that takes the samples: a timer of its own in place of a program's loop"
CHECK_COLOURED = (
    "noise in the band of the motion that is louder than above it: cable and connector, 1/f noise of a MEMS "
    "sensor, vibration across its axis, which one axis cannot tell from noise"
)
#: What a remainder may be that is predictable from each of these.
LOOKS_LIKE = {
    "position": "a spring, a magnet or a stop that the catalogue does not describe",
    "speed": "friction or drag of another law",
    "position and speed": "flow forces, or friction that depends on the place",
    "the way since the last reversal": "hysteresis, as of friction before it slides",
    "time": "something that changes over the record: oil that warms, a sensor that drifts",
    "frequency": "a filter or a resonance of the measuring chain or its mounting",
    "nothing": "noise that is louder than what the record shows above its excitation, or motion that "
    "parts from the model's at chance",
}


@dataclass(frozen=True, slots=True)
class Outcome:
    """Verdict with its reasons; fields as those of the result."""

    verdict: str
    confidence: Confidence
    signs: Mapping[str, float]
    sentence: str
    effects: tuple[str, ...]
    runner_up: RankedHypothesis | None
    candidates: tuple[str, ...]
    floor: Floor
    rest: PredictableShares
    remainder: Remainder | None
    extra: Mapping[str, Quantity]
    small: Mapping[str, float]
    nuisances: tuple[Nuisance, ...]
    warnings: tuple[str, ...]
    advice: str


def judge_outcome(
    state: SelectionState, numbers: Fitted, saturation: Saturation, *, trusted: bool, corrected: int = 0
) -> Outcome:
    """Return the verdict on what ``state`` accepted, with its ``numbers``.

    ``trusted``: both channels are of one valve; ``corrected``: nuisances that were taken out of the records.
    """
    final = state.hypothesis
    residue = residue_of(state)
    extra = _limit_of(saturation)
    hum = _hum(final)
    # What the body did while its channel clipped is restored by a curve: a gain is not told from that.
    told_apart = {*CHAIN, *(["periodic_force"] if hum else []), *_of_clipped_body(saturation)}
    named_ones = tuple(name for name in final.effects if name not in told_apart)
    shares = {name: share_of(state, name) for name in named_ones}
    small = {name: share for name, share in shares.items() if share < state.fitting.settings.least_share}
    named_ones = tuple(name for name in named_ones if name not in small)
    clipped_alone = bool(extra) and _nothing_but_clips(state, residue, saturation)
    left_out = clipped_alone or _hardly_explain(state, residue)
    clipped = ("sensor_saturation",) if extra else ()
    names = (*(() if left_out else named_ones), *clipped)
    candidates: tuple[str, ...] = ()
    jitter = _jitter(state, final)
    # Jitter comes and goes with the motion without being a part of it.
    jitters = jitter is not None and not residue.predictable
    is_open = residue.unexplained and not clipped_alone and not jitters
    if is_open and names and 1.0 - residue.share >= EXPLAINS:
        verdict = "+".join((*names, "unexplained"))
    elif is_open and clipped:
        # Flat tops are seen without any model, whatever else is there.
        names, verdict = clipped, "+".join((*clipped, "unexplained"))
    elif is_open:
        candidates = named_ones or tuple(row.id for row in state.ranking[:1])
        verdict = "unexplained"
    else:
        verdict = "+".join(names) or "none"
    # Strong friction, too, spoils the coherence; a model that explains the record settles that.
    doubtful = not trusted and (residue.unexplained or not names)
    verdict = "unexplained" if doubtful else verdict
    effects = names if verdict not in ("none", "unexplained") else ()
    if verdict == "none":
        text = missing_nothing(state, residue.floor.nrmse)
    elif verdict == "unexplained":
        text = unnamed(state, residue, candidates)
    else:
        text = named(state, numbers, effects, extra, residue.floor.nrmse)
    nuisances = (*_nuisances(state, numbers, saturation, jitter, residue, is_open=is_open), *hum)
    signs = _signs(state, residue, shares, corrected + len(nuisances))
    confidence = calibrated(verdict, signs)
    if doubtful:
        confidence = replace(confidence, value=min(confidence.value, DOUBTFUL))
    left = _left(residue) if is_open else None
    if left is not None and effects:
        text = f"{text} {still_missing(left)}"
    return Outcome(
        verdict=verdict,
        confidence=confidence,
        signs=signs,
        sentence=text,
        effects=effects,
        runner_up=_runner_up(state),
        candidates=candidates,
        floor=residue.floor,
        rest=residue.remainder,
        remainder=left,
        extra=extra,
        warnings=(jitter.sentence,) if jitter else (),
        small=small,
        nuisances=nuisances,
        advice=_advice(candidates or effects),
    )


def _hardly_explain(state: SelectionState, residue: FinalResidual) -> bool:
    """Whether names explain less than a tenth of a gap that is larger than noise: chance does as much."""
    before = state.fitting.nrmse(state.steps[0])
    hardly = 1.0 - residue.share < EXPLAINS and before > LARGER * residue.floor.nrmse
    # Where runs are synchronised, free ones part from the record at chance.
    return hardly and not state.synchronised


def _of_clipped_body(saturation: Saturation) -> tuple[str, ...]:
    return ("spool_gain_error",) if "body" in saturation.limits else ()


def _hum(final: Hypothesis) -> tuple[Nuisance, ...]:
    """Return the mains hum that a periodic force of ``final`` is not distinguished from, if it has one."""
    if "periodic_force" not in final.effects:
        return ()
    values = final.point.values
    frequency = float(values["force_frequency"])
    if not any(abs(frequency / (mains * max(1, round(frequency / mains))) - 1.0) < STRAY for mains in MAINS):
        return ()
    turn = 2j * np.pi * frequency
    stiffness = values["mass"] * turn**2 + values["viscous_coefficient"] * turn + values["spring_stiffness"]
    size = abs(values["force_amplitude"] * turn**2 / stiffness)
    return (Nuisance("hum", "spool", float(size), "m/s^2", Hum.check, corrected=False),)


def _nuisances(
    state: SelectionState,
    numbers: Fitted,
    saturation: Saturation,
    jitter: Jitter | None,
    residue: FinalResidual,
    *,
    is_open: bool,
) -> Iterator[Nuisance]:
    """Yield what the measuring chain did that is in the final model, or in what that leaves."""
    for name in (name for name in state.hypothesis.effects if name in CHAIN):
        yield CHAIN[name].found(numbers.point.values, numbers.deviations)
    for channel, limit in sorted(saturation.limits.items()):
        yield Nuisance("clipping", channel, limit, "m/s^2", CHECK_CLIPPING, 0.01 * limit)
    if jitter is not None:
        yield Nuisance("jitter", "spool", jitter.deviation, "s", CHECK_JITTER)
    # What jumps and hits leave is louder than noise, too.
    if not is_open and residue.power > COLOURED and not state.hypothesis.has_kinks:
        after = state.fitting.nrmse(state.hypothesis)
        measured = state.fitting.simulation.measured(state.fitting.simulation.held_out)
        rms = float(np.sqrt(np.mean(np.concatenate([row.ravel() for row in measured]) ** 2)))
        yield Nuisance("coloured_noise", "spool", after * rms, "m/s^2", CHECK_COLOURED)


def _nothing_but_clips(state: SelectionState, residue: FinalResidual, saturation: Saturation) -> bool:
    """Whether nothing is missing but what a channel clips, whatever its samples leave next to that."""
    if "body" not in saturation.limits:
        return not state.hypothesis.effects and residue.power < CLIPPED_MAY_LEAVE
    # What moved the spool while the body's channel clipped is not known: that leaves more than any noise.
    return not state.hypothesis.effects or 1.0 - residue.share < MOST_OF_IT


def _left(residue: FinalResidual) -> Remainder:
    """Return what is left, by what predicts most of it."""
    rest = residue.remainder
    follows = rest.follows if rest.share > THRESHOLDS.predictable else "nothing"
    return Remainder(residue.share, residue.power, follows, LOOKS_LIKE[follows])


def _limit_of(saturation: Saturation) -> dict[str, Quantity]:
    """Return the limit of the spool's channel as a number of the verdict, where that clips."""
    limit = saturation.limits.get("spool")
    if limit is None:
        return {}
    found = Quantity("saturation_limit", "m/s^2", limit, 0.01 * limit, Validity.VALID)
    return {found.name: found}


def _advice(names: tuple[str, ...]) -> str:
    """Return which excitation distinguishes the effects ``names`` from confusable ones."""
    told = (EFFECTS[name].distinguished_by for name in names if name in EFFECTS)
    return "; ".join(dict.fromkeys(text for text in told if text))


def _jitter(state: SelectionState, final: Hypothesis) -> Jitter | None:
    """Return the jitter of the samples if there is one; forces with kinks leave what looks like that."""
    if final.has_kinks:
        return None
    simulation = state.fitting.simulation
    chosen = [*simulation.training, *simulation.held_out]
    found = sampling_jitter(simulation, [*final.train, *final.held], chosen)
    return found if found is not None and found.tells else None


def _runner_up(state: SelectionState) -> RankedHypothesis | None:
    others = [row for row in state.ranking if not row.accepted and not row.jointly_with]
    return max(others, key=lambda row: row.evidence, default=None)


def _signs(
    state: SelectionState, residue: FinalResidual, shares: Mapping[str, float], nuisances: int
) -> dict[str, float]:
    """Return what the confidence goes by."""
    stretches = state.fitting.stretches
    importance = [share for share in shares.values() if math.isfinite(share)]
    least = min(importance, default=IMPORTANT)
    return {
        "margin": logarithm(_margin(state)),
        "passed_over": logarithm(
            max((row.evidence for row in state.ranking if not row.accepted), default=0.0)
        ),
        "importance": math.log(max(least, 1e-6)),
        "power": logarithm(residue.power),
        "predictable": residue.remainder.share,
        "share": residue.share,
        "level": residue.level.share,
        "names": float(len(shares)),
        "nuisances": float(nuisances),
        "sample_rate": 1.0 / stretches[0].record.sample_period,
        "duration": sum(stretch.record.duration for stretch in stretches),
    }


def _margin(state: SelectionState) -> float:
    """Return the least evidence of a name over the runner-up of its step, infinite without names."""
    final = state.hypothesis
    margins = [margin for name, margin in state.overruled.items() if name not in final.effects]
    for step in state.steps[1:]:
        name = step.newest
        own = next((row for row in state.ranking if row.id == name and row.accepted), None)
        if own is not None and name in final.effects:
            margins.append(own.evidence - max([0.0, *(row.evidence for row in _rivals(state, own))]))
    return min(margins, default=math.inf)


def _rivals(state: SelectionState, own: RankedHypothesis) -> list[RankedHypothesis]:
    """Return what was tried in place of ``own``.

    A law that contains this one always fits a little better, and was weighed against it.
    """
    return [
        row
        for row in state.ranking
        if row.jointly_with == own.jointly_with
        and row.id != own.id
        and not row.reason
        and row.id not in state.overruled
        and own.id not in EFFECTS[row.id].replaces
        and row.id not in EFFECTS[own.id].replaces
    ]
