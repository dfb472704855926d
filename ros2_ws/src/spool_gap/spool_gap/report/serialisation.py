"""Serialisation of a result in types of JSON: SI units, ``None`` for what is not known."""

from __future__ import annotations

import math
from typing import Any

from spool_core.uncertainty import Quantity
from spool_estimator.identification.nuisances.record_nuisance import Nuisance

from spool_gap.result import (
    GapResult,
    HeldOutAgreement,
    ProfileLikelihood,
    RankedHypothesis,
    Remainder,
    Share,
    Where,
)


def result_to_dict(result: GapResult) -> dict[str, Any]:
    """Return ``result`` as JSON takes it."""
    return {
        "record": result.record,
        "kind": result.kind,
        "base_model": result.base_model,
        "where": _where(result.where),
        "where_after": _where(result.where_after),
        "effects": [
            {
                "id": effect.id,
                "parameters": _quantities(effect.parameters),
                "nrmse_before": number(effect.nrmse_before),
                "nrmse_after": number(effect.nrmse_after),
                "evidence": number(effect.evidence),
                "meaning": effect.meaning,
                "check": effect.check,
            }
            for effect in result.effects
        ],
        "verdict": result.verdict,
        "remainder": _remainder(result.remainder),
        "nuisances": [_nuisance(entry) for entry in result.nuisances],
        "small_effects": [
            {"id": entry.id, "parameters": _quantities(entry.parameters), "share": number(entry.share)}
            for entry in result.small_effects
        ],
        "confidence": number(result.confidence),
        "confidence_note": result.confidence_note or None,
        "confidence_from": {name: number(value) for name, value in result.signs.items()},
        "sentence": result.sentence,
        "candidates": list(result.candidates),
        "runner_up": None if result.runner_up is None else _hypothesis(result.runner_up),
        "ranking": [_hypothesis(entry) for entry in result.ranking],
        "base": _quantities(result.base),
        "parameters": _quantities(result.parameters),
        "gap": {
            "before": _agreement(result.before, result.kind),
            "after": _agreement(result.after, result.kind),
            "noise_floor": number(result.noise_floor),
        },
        "predictable_share": {name: number(share) for name, share in result.predictable.items()},
        "profiles": {one.name: _profile(one) for one in result.profiles},
        "warnings": list(result.warnings),
        "advice": result.advice or None,
        "seconds_of_data": number(result.seconds),
        "elapsed_s": number(result.elapsed),
    }


def number(value: float) -> float | None:
    """Return ``value``, or ``None`` where it is not a finite number."""
    return float(value) if math.isfinite(value) else None


def _remainder(left: Remainder | None) -> dict[str, Any] | None:
    if left is None:
        return None
    return {
        "share": number(left.share),
        "over_noise_floor": number(left.over_noise_floor),
        "function_of": left.function_of,
        "looks_like": left.looks_like,
    }


def _nuisance(entry: Nuisance) -> dict[str, Any]:
    return {
        "id": entry.id,
        "channel": entry.channel,
        "size": number(entry.size),
        "std": number(entry.deviation),
        "unit": entry.unit,
        "corrected": entry.corrected,
        "check": entry.check,
    }


def _profile(one: ProfileLikelihood) -> dict[str, Any]:
    return {
        "verdict": one.verdict,
        "sentence": one.sentence,
        "low": one.low,
        "high": one.high,
        "unit": one.unit,
        "together_with": one.partner or None,
        "values": list(one.values),
        "rises": [number(rise) for rise in one.rises],
    }


def _quantities(entries: tuple[Quantity, ...]) -> dict[str, Any]:
    return {
        entry.name: {
            "value": number(entry.value),
            "std": number(entry.standard_deviation),
            "unit": entry.unit,
        }
        for entry in entries
    }


def _agreement(agreement: HeldOutAgreement, kind: str) -> dict[str, Any]:
    found = {"nrmse": number(agreement.nrmse), "amplitude_ratio": number(agreement.amplitude_ratio)}
    return found | ({"position_rmse_m": number(agreement.position_rmse)} if kind == "driven" else {})


def _hypothesis(entry: RankedHypothesis) -> dict[str, Any]:
    return {
        "id": entry.id,
        "jointly_with": list(entry.jointly_with),
        "nrmse_after": number(entry.nrmse_after),
        "evidence": number(entry.evidence),
        "parameters": {name: number(value) for name, value in entry.parameters.items()},
        "accepted": entry.accepted,
        "reason": entry.reason,
    }


def _where(where: Where) -> dict[str, Any]:
    rows = {
        name: [_share(share) for share in getattr(where, name)]
        for name in ("frequency", "displacement", "velocity", "direction", "time", "phase")
    }
    return {**rows, "sentence": where.sentence}


def _share(share: Share) -> dict[str, Any]:
    unit = share.unit.replace("/", "_per_")
    return {f"low_{unit}": share.low, f"high_{unit}": share.high, "share": share.share, "floor": share.floor}
