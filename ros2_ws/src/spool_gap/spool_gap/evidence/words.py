"""Words of a result: verdict, what is missing and how big, what it means, what to check, what is doubted."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from spool_core.uncertainty import PLUS_MINUS, Quantity, Validity, percent, with_interval
from spool_estimator.identification.nuisances.record_nuisance import Nuisance
from spool_sim.model import Model

from spool_gap.evidence.decision import Decision
from spool_gap.evidence.held_out import Judged
from spool_gap.evidence.look import Look
from spool_gap.likelihood.chain_part import CHAIN_PARTS
from spool_gap.registry import EFFECTS
from spool_gap.report.outcome import CHECK_COLOURED, COLOURED, DOUBTFUL, LOOKS_LIKE
from spool_gap.result import Remainder
from spool_gap.thresholds import THRESHOLDS

SATURATION, UNEXPLAINED = "sensor_saturation", "unexplained"


@dataclass(frozen=True, slots=True)
class Words:
    """Verdict in words; fields as those of the result. ``extra``: numbers of effects that no fit has."""

    verdict: str
    confidence: float
    sentence: str
    effects: tuple[str, ...]
    candidates: tuple[str, ...]
    remainder: Remainder | None
    nuisances: tuple[Nuisance, ...]
    advice: str
    warnings: tuple[str, ...] = ()
    confidence_note: str = ""
    extra: Mapping[str, tuple[Quantity, ...]] = field(default_factory=dict)


def words_of(decision: Decision, look: Look, base: Model, before: Judged, after: Judged) -> Words:
    """Return the words for ``decision`` on records with ``look``."""
    names = [*decision.effects]
    extra: dict[str, tuple[Quantity, ...]] = {}
    if "spool" in look.limits:
        limit = look.limits["spool"]
        extra[SATURATION] = (Quantity("saturation_limit", "m/s^2", limit, 0.01 * limit, Validity.VALID),)
        names.append(SATURATION)
    # A free run that leaves no more than noise explains the record, whatever its prediction errors follow.
    open_ = decision.unexplained and after.agreement.nrmse > after.floor
    doubtful = not look.trusted and (open_ or not names)
    candidates: tuple[str, ...] = ()
    if doubtful or (open_ and not names):
        candidates = tuple(decision.effects) or decision.nearest
        verdict, names = UNEXPLAINED, []
    elif names:
        verdict = "+".join([*names, UNEXPLAINED] if open_ else names)
    else:
        verdict = "none"
    power = (after.agreement.nrmse / max(after.floor, 1e-12)) ** 2
    remainder = _remainder(decision, power, before, after) if open_ else None
    nuisances = [*look.nuisances, *(_told(decision, key) for key in decision.parts)]
    if not open_ and power > COLOURED and not decision.fit.structure.jumps:
        nuisances.append(Nuisance("coloured_noise", "spool", _rms(after), "m/s^2", CHECK_COLOURED))
    if verdict == "none":
        text = (
            f"Nothing is missing: '{base.name}' leaves {percent(after.agreement.nrmse)} of the spool's "
            f"acceleration, noise alone {percent(after.floor)}."
        )
    elif verdict == UNEXPLAINED:
        text = _unnamed(decision, base, candidates, before, after)
    else:
        text = _named(decision, names, extra, before, after)
        if remainder is not None:
            text = f"{text} {_still_missing(remainder)}"
    warnings = []
    if after.agreement.nrmse > THRESHOLDS.explains_nothing:
        warnings.append(
            f"even the best model leaves {100.0 * after.agreement.nrmse:.3g} % of the spool's acceleration: "
            "units of both channels, order and sign of the columns, valve file?"
        )
    confidence = min(decision.confidence, DOUBTFUL) if doubtful else decision.confidence
    told = (EFFECTS[name].distinguished_by for name in (*names, *candidates) if name in EFFECTS)
    return Words(
        verdict, confidence, text, tuple(names), candidates, remainder, tuple(nuisances),
        "; ".join(dict.fromkeys(one for one in told if one)), tuple(warnings), extra=extra,
    )  # fmt: skip


def _told(decision: Decision, key: str) -> Nuisance:
    return CHAIN_PARTS[key].told(decision.fit.structure.values, decision.numbers.deviations)


def _rms(judged: Judged) -> float:
    size = math.sqrt(
        sum(float((rows[0] ** 2).sum()) for rows in judged.rows) / sum(rows.shape[1] for rows in judged.rows)
    )
    return judged.agreement.nrmse * size


def _remainder(decision: Decision, power: float, before: Judged, after: Judged) -> Remainder:
    gap = max(before.agreement.nrmse**2 - after.floor**2, 1e-12)
    share = max(after.agreement.nrmse**2 - after.floor**2, 0.0) / gap
    follows = decision.rest.follows
    return Remainder(min(share, 1.0), power, follows, LOOKS_LIKE.get(follows, LOOKS_LIKE["nothing"]))


def _unnamed(
    decision: Decision, base: Model, candidates: tuple[str, ...], before: Judged, after: Judged
) -> str:
    near = f"; nearest come {', '.join(candidates)}" if candidates else ""
    if decision.rest.follows != "nothing":
        near += f". What is left follows {decision.rest.follows}"
    return (
        f"Something is missing that has no name here: '{base.name}' leaves {percent(before.agreement.nrmse)} "
        f"of the spool's acceleration, the best of the catalogue {percent(after.agreement.nrmse)}, "
        f"noise would leave {percent(after.floor)}{near}."
    )


def _named(
    decision: Decision,
    names: list[str],
    extra: Mapping[str, tuple[Quantity, ...]],
    before: Judged,
    after: Judged,
) -> str:
    parts = []
    known = {one.name: one for one in decision.numbers.quantities}
    for name in names:
        entry = EFFECTS[name]
        own = extra.get(name) or [known[one] for one in entry.fitted if one in known]
        sizes = [f"{one.name} {with_interval(one.value, one.standard_deviation, one.unit)}" for one in own]
        told = f"{', '.join(sizes)}; {PLUS_MINUS}"
        parts.append(f"{name.replace('_', ' ')} ({told}): {entry.on_the_machine}; check {entry.to_check}")
    return (
        f"The model lacks {'; and '.join(parts)}. With it the error falls from "
        f"{percent(before.agreement.nrmse)} to {percent(after.agreement.nrmse)} of the spool's acceleration "
        f"(noise alone: {percent(after.floor)})."
    )


def _still_missing(left: Remainder) -> str:
    follows = "nothing predicts it" if left.function_of == "nothing" else f"it follows {left.function_of}"
    return (
        f"Something else is left, {left.over_noise_floor:.3g} times the noise's power and "
        f"{percent(left.share)} of the gap's; {follows}: {left.looks_like}."
    )
