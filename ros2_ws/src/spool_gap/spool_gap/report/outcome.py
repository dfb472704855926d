"""The verdict: what is named, how sure that is, and when nothing is named."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit
from spool_stream.quantity import Quantity, Validity
from spool_stream.uncertainty import PLUS_MINUS, percent, with_interval

from spool_gap.checks.saturation import Saturation
from spool_gap.fitting.hypothesis import Step
from spool_gap.registry import EFFECTS
from spool_gap.result import GapSettings, Hypothesis
from spool_gap.screening.remainder import FORETOLD, Remainder, remainder
from spool_gap.selection.median_window import usual_excess, usual_share
from spool_gap.selection.rules import CLOSED, EVIDENCE
from spool_gap.selection.search import Search
from spool_gap.simulation.jitter import EVIDENCE as JITTER
from spool_gap.simulation.jitter import Jitter, sampling_jitter
from spool_gap.simulation.noise_floor import Floor, excess, noise_floor
from spool_gap.simulation.simulate import Simulation

Array = NDArray[np.float64]

#: Residual power over the floor's, in the drive's band, from which something is left to explain where
#: the error exceeds ``CLOSED`` floors, and this share of the gap's amplitude stays, in all or usually.
LEFT_OVER, MAY_STAY = 1.8, 0.05
#: The same without kinks in the force: nothing excuses what a smooth model leaves.
SMOOTH_MAY_STAY = 0.01
#: The same where the motion is sensitive to the hits of stops, with which the right numbers leave a third of
#: the usual window.
SENSITIVE, SENSITIVE_MAY_STAY = "end_stop", 0.5
#: Error over the noise floor up to which what is left may be noise: the floor is known to some 5 %.
ABOVE_FLOOR = 1.1
#: Share of the gap's amplitude that forces which are named may leave at most, beyond that: of 970 blind cases
#: none that was named right left more than 0.51.
HARDLY = 0.7
#: Share of right names where more than that is left, no more than blind cases had.
INCOMPLETE = 0.9


@dataclass(frozen=True, slots=True)
class Outcome:
    """The verdict with its reasons; fields as those of the result."""

    verdict: str
    confidence: float
    sentence: str
    effects: tuple[str, ...]
    runner_up: Hypothesis | None
    candidates: tuple[str, ...]
    floor: Floor
    rest: Remainder
    extra: Mapping[str, Quantity]
    warnings: tuple[str, ...]
    advice: str


@dataclass(frozen=True, slots=True)
class _Judged:
    """What is judged by: free runs, or coupled ones where the motion can go several ways.

    Attributes:
        simulation: of the windows.
        before, held: errors of the base and of the hypothesis on those held out, m/s^2, shape (1, n) each.
        train: of the hypothesis on the others.
        floor: what noise leaves.
    """

    simulation: Simulation
    before: list[Array]
    train: list[Array]
    held: list[Array]
    floor: Floor

    def nrmse(self, errors: list[Array]) -> float:
        """Held out."""
        return float(self.simulation.nrmse(errors, self.simulation.held_out)[0])


def _judged(search: Search, final: Step, floor: Floor) -> _Judged:
    base, coupled = search.steps[0], search.coupled
    if coupled is None:
        return _Judged(search.simulation, base.held, final.train, final.held, floor)
    point, held = final.fitted.point, coupled.held_out
    errors = coupled.errors([point], held)
    return _Judged(
        coupled,
        coupled.errors([base.fitted.point], held),
        coupled.errors([point], coupled.training),
        errors,
        noise_floor(coupled, point, errors),
    )


def _runs_free(search: Search, final: Step, floor: Floor) -> bool:
    """Whether coupled runs judge, but free ones come down to the floor, in all or usually.

    The measured velocity that runs are coupled to has errors, too, not to be told from the model's.
    """
    free = min(search.nrmse(final) / floor.nrmse, usual_excess(final.held, floor.errors))
    return search.coupled is not None and free < CLOSED


def judge_outcome(
    search: Search, final: Step, saturation: Saturation, settings: GapSettings, *, trusted: bool
) -> Outcome:
    """Return the verdict on what ``search`` accepted."""
    del settings
    floor = noise_floor(search.simulation, final.fitted.point, final.held)
    seen = _judged(search, final, floor)
    before, after = (seen.nrmse(errors) for errors in (seen.before, seen.held))
    noise = seen.floor.nrmse
    stays = _share(before, after, noise)
    stays = min(stays, usual_share(seen.before, seen.held, seen.floor.errors))
    # Coupled runs follow through hits, too.
    chaotic = SENSITIVE in final.effects and search.coupled is None
    most = SENSITIVE_MAY_STAY if chaotic else MAY_STAY
    most = most if search.has_kinks(final) else SMOOTH_MAY_STAY
    left = excess(seen.simulation, seen.held, seen.floor)
    seen.simulation.take_weight(
        seen.train, seen.simulation.training, [0.5 * s.noise.spool for s in seen.simulation.stretches]
    )
    rest = remainder(seen.simulation, final.fitted.point, seen.train, seen.held)
    follows = rest.tells(after, before, kinks=search.has_kinks(final)) and not chaotic
    named = list(final.effects)
    extra: dict[str, Quantity] = {}
    if saturation.channel == "spool":
        named.append("sensor_saturation")
        extra["saturation_limit"] = Quantity(
            "saturation_limit", "m/s^2", saturation.limit, 0.01 * saturation.limit, Validity.VALID
        )
    runner = _runner_up(search)
    # Where nothing was added there is no gap to measure the remainder by, only the floor.
    follows = follows and after > (ABOVE_FLOOR if final.effects else CLOSED) * noise
    still_open = left > LEFT_OVER and after > CLOSED * noise
    unexplained = follows or (still_open and (stays > most or not final.effects))
    unexplained = unexplained and not _runs_free(search, final, floor)
    unexplained = unexplained or (bool(final.effects) and _hardly(search, final, floor.nrmse))
    candidates: tuple[str, ...] = ()
    warnings: list[str] = []
    if unexplained and not (saturation.channel == "spool" and not final.effects and left < 3.0):
        candidates = tuple(final.effects) or tuple(h.id for h in search.ranking[:1])
        verdict = "unexplained"
        confidence = 1.0 - 0.5 / max(1.0, left / LEFT_OVER, rest.evidence / EVIDENCE)
    elif named:
        verdict = "+".join(named)
        confidence = _confidence(search, final, left)
    else:
        verdict = "none"
        confidence = min(0.99, 1.0 / max(1.0, left))
    scatter = _jitter(search, final)
    if scatter is not None:
        warnings.append(scatter.sentence)
        if verdict == "none":
            verdict, confidence = "unexplained", min(0.99, 1.0 - 0.5 * JITTER / scatter.evidence)
        else:
            scatter = None
    # Strong friction, too, spoils the coherence; a model that explains the record settles that.
    if not trusted and (unexplained or not named):
        verdict, confidence = "unexplained", min(confidence, 0.3)
    effects = tuple(named) if verdict not in ("none", "unexplained") else ()
    advice = "; ".join(
        dict.fromkeys(
            EFFECTS[n].told_by for n in (candidates or effects) if n in EFFECTS and EFFECTS[n].told_by
        )
    )
    return Outcome(
        verdict, confidence,
        sentence(verdict, effects, candidates, search, final, floor.nrmse, rest, extra, scatter),
        effects, runner, candidates, floor, rest, extra, tuple(warnings), advice,
    )  # fmt: skip


def _share(before: float, after: float, noise: float) -> float:
    """Return the share of the gap's amplitude that ``after`` holds: 1 where there is no gap."""
    gap = math.sqrt(max(before**2 - noise**2, 0.0))
    return math.sqrt(max(after**2 - noise**2, 0.0)) / gap if gap > 0.0 else 1.0


def _hardly(search: Search, final: Step, noise: float) -> bool:
    """Whether free runs of ``final`` leave most of the gap, whatever coupled ones do."""
    after = search.nrmse(final)
    return after > ABOVE_FLOOR * noise and _share(search.nrmse(search.steps[0]), after, noise) > HARDLY


def _jitter(search: Search, final: Step) -> Jitter | None:
    """Return the jitter of the samples if there is one; forces with kinks leave what looks like that."""
    if search.has_kinks(final):
        return None
    simulation = search.simulation
    chosen = [*simulation.training, *simulation.held_out]
    found = sampling_jitter(simulation, [*final.train, *final.held], chosen)
    return found if found is not None and found.tells else None


def _runner_up(search: Search) -> Hypothesis | None:
    others = [h for h in search.ranking if not h.accepted and not h.beside]
    return max(others, key=lambda h: h.evidence, default=None)


def _confidence(search: Search, final: Step, left: float) -> float:
    """Return the confidence: from the evidence over the runner-up of each step, and what is left."""
    sure = 0.99
    for step in search.steps[1:]:
        name = step.effects[-1]
        own = next((h for h in search.ranking if h.id == name and h.accepted), None)
        if own is None or name not in final.effects:
            continue
        # A law that contains this one always fits a little better, and was weighed against it.
        rivals = [
            h.evidence
            for h in search.ranking
            if h.beside == own.beside
            and h.id != own.id
            and not h.reason
            and h.id not in search.overruled
            and own.id not in EFFECTS[h.id].replaces
            and h.id not in EFFECTS[own.id].replaces
        ]
        margin = own.evidence - max([0.0, *rivals])
        sure *= float(expit(0.08 * margin))
    for name, margin in search.overruled.items():
        if name not in final.effects:
            sure *= float(expit(0.08 * margin))
    return float(sure * (INCOMPLETE if left > LEFT_OVER else 1.0))


def sentence(
    verdict: str,
    effects: tuple[str, ...],
    candidates: tuple[str, ...],
    search: Search,
    final: Step,
    floor: float,
    rest: Remainder,
    extra: Mapping[str, Quantity],
    scatter: Jitter | None,
) -> str:
    """Return the verdict in a sentence."""
    before, after = search.nrmse(search.steps[0]), search.nrmse(final)
    base = search.base.name
    if verdict == "none":
        return (
            f"Nothing is missing: '{base}' leaves {percent(after)} of the spool's acceleration, "
            f"noise alone {percent(floor)}."
        )
    if verdict == "unexplained" and scatter is not None and not candidates:
        return (
            f"No force is missing, but {scatter.sentence}. '{base}' leaves {percent(after)} of the "
            "spool's acceleration."
        )
    if verdict == "unexplained":
        near = f"; nearest come {', '.join(candidates)}" if candidates else ""
        if rest.share > FORETOLD:
            near += f". What is left follows {rest.follows}: {100.0 * rest.share:.0f} % of it can be foretold"
        return (
            f"Something is missing that has no name here: '{base}' leaves {percent(before)} of "
            f"the spool's acceleration, the best of the catalogue {percent(after)}, "
            f"noise would leave {percent(floor)}{near}."
        )
    parts = []
    for name in effects:
        entry = EFFECTS[name]
        numbers = []
        for parameter in entry.fitted:
            known = extra.get(parameter)
            value = known.value if known else final.fitted.point.get(parameter)
            unit = known.unit if known else final.fitted.point.unit(parameter)
            spread = known.standard_deviation if known else final.fitted.deviations.get(parameter, math.nan)
            numbers.append(f"{parameter} {with_interval(value, spread, unit)}")
        told = f"{', '.join(numbers)}; {PLUS_MINUS}"
        parts.append(f"{name.replace('_', ' ')} ({told}): {entry.on_the_machine}; check {entry.to_check}")
    return (
        f"The model lacks {'; and '.join(parts)}. With it the error falls from {percent(before)} to "
        f"{percent(after)} of the spool's acceleration (noise alone: {percent(floor)})."
    )
