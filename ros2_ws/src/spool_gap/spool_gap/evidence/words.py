"""Words of a result: verdict, what is missing and how big, what it means, what to check, what is doubted."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from spool_core.uncertainty import Quantity, Validity
from spool_estimator.identification.nuisances.record_nuisance import Nuisance
from spool_sim.model import Model

from spool_gap.evidence.decision import Decision
from spool_gap.evidence.held_out import Judged
from spool_gap.evidence.jitter import sentence
from spool_gap.evidence.look import Look
from spool_gap.likelihood.chain_part import CHAIN_PARTS
from spool_gap.registry import EFFECTS
from spool_gap.report.wording import (
    CHECK_COLOURED,
    LOOKS_LIKE,
    UNEXPLAINED,
    named,
    nothing_missing,
    still_missing,
    unnamed,
)
from spool_gap.result import Remainder
from spool_gap.thresholds import THRESHOLDS

SATURATION, COMPARED = "sensor_saturation", "the spool's acceleration"
#: Power of the remainder over the white noise's from which noise is called coloured: the density of white
#: noise is known to some 10 %, that of the residual to some 20 %.
COLOURED = 2.0
#: Confidence at most where the channels may not be of one valve: even that they are is doubted.
DOUBTFUL = 0.3


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


def words_of(
    decision: Decision, look: Look, base: Model, before: Judged, after: Judged, jitter: Nuisance | None = None
) -> Words:
    """Return the words for ``decision`` on records with ``look``, whose sampling instants may scatter."""
    names = [*decision.effects]
    extra: dict[str, tuple[Quantity, ...]] = {}
    if "spool" in look.limits:
        limit = look.limits["spool"]
        extra[SATURATION] = (Quantity("saturation_limit", "m/s^2", limit, 0.01 * limit, Validity.VALID),)
        names.append(SATURATION)
    open_ = decision.unexplained
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
    if jitter is not None:
        nuisances.append(jitter)
    elif not open_ and power > COLOURED and not decision.fit.structure.jumps:
        nuisances.append(Nuisance("coloured_noise", "spool", _rms(after), "m/s^2", CHECK_COLOURED))
    errors = before.agreement.nrmse, after.agreement.nrmse, after.floor, COMPARED
    if verdict == "none":
        text = nothing_missing(base.name, *errors[1:])
    elif verdict == UNEXPLAINED:
        text = unnamed(base.name, candidates, decision.rest.follows, *errors)
    else:
        known = {one.name: one for one in decision.numbers.quantities}
        numbers = {name: [known[own] for own in EFFECTS[name].fitted if own in known] for name in names}
        text = named([(name, extra.get(name) or numbers[name]) for name in names], *errors)
        if remainder is not None:
            text = f"{text} {still_missing(remainder)}"
    warnings = [] if jitter is None else [sentence(jitter)]
    if after.agreement.nrmse > THRESHOLDS.explains_nothing:
        warnings.append(
            f"even the best model leaves {100.0 * after.agreement.nrmse:.3g} % of the spool's acceleration: "
            "units of both channels, order and sign of the columns, valve file?"
        )
    # Where something is left, the name beside it may be that of the nearest law.
    capped = doubtful or (open_ and bool(names))
    confidence = min(decision.confidence, DOUBTFUL) if capped else decision.confidence
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
