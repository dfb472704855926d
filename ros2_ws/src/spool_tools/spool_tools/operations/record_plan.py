"""Plan of a record: the question put to it, what it would tell, and what the sensors have to stand."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from spool_core.errors import InputError
from spool_core.quantity import Quantity
from spool_core.uncertainty import LEGEND, number, percent, with_interval
from spool_estimator.identification.record import Record
from spool_sim.model import load_model
from spool_sim.valve.description import find_valve

from spool_tools.console.outputs import write_json
from spool_tools.console.progress import progress
from spool_tools.input.recorded_excitation import find_excitation
from spool_tools.planning.effects_named import SHARES, USUAL, Named, named_effects
from spool_tools.planning.planned import Plan, travel
from spool_tools.planning.questions import WHICH_EFFECT, Answer, question

#: s: shorter records hold no window of a fit (4 s) and a piece to judge it by; longer ones cost minutes.
SHORTEST, LONGEST = 8.0, 600.0
#: Ranges that accelerometers come in, g, and how far above the largest sample of a plan one is chosen.
RANGES, MARGIN, G = (2, 4, 8, 16, 25, 50, 100, 200, 500), 2.0, 9.80665


def plan_record(
    valve: str,
    name: str,
    excitation: str,
    seconds: float,
    sample_rate: float,
    noise: float,
    seed: int,
    effects: Sequence[str],
    json: Path | None,
) -> int:
    """Say what a record as planned would tell; return 1 where it would tell nothing of the question.

    Raises:
        InputError: valve, question, excitation or numbers cannot be used.
    """
    if not SHORTEST <= seconds <= LONGEST:
        raise InputError(f"--seconds {seconds:g}: plan {SHORTEST:g} to {LONGEST:g} s")
    ask = None if name == WHICH_EFFECT else question(name)
    described = find_valve(valve)
    plan = Plan(described, find_excitation(excitation), seconds, sample_rate, noise, seed)
    quiet = plan.record(load_model("fluid"), {}, noisy=False)
    answer, found = Answer(), list[Named]()
    with progress(f"planning {name}", 1.0) as advance:
        if float(np.sqrt(np.mean((quiet.spool - quiet.body) ** 2))) <= noise:
            answer = Answer(reason="this excitation moves the spool by less than the sensors' noise")
        elif ask is not None:
            answer = ask(plan)
        else:
            done = 0.0
            for one in named_effects(plan, effects or USUAL):
                found.append(one)
                share = 1.0 / (len(effects or USUAL) * len(SHARES))
                advance(share)
                done += share
    result = _dictionary(plan, valve, name, excitation, quiet, answer, found)
    if json is not None:
        write_json(json, result)
    _show(result, answer, found)
    told = answer.limit is not None or (answer.parameters and answer.reason is None)
    return 0 if told or any(one.right for one in found) else 1


def _dictionary(
    plan: Plan, valve: str, name: str, excitation: str, quiet: Record, answer: Answer, found: Sequence[Named]
) -> dict[str, Any]:
    truth = answer.truth or {}
    limit = answer.limit
    peaks = {channel: float(np.max(np.abs(getattr(quiet, channel)))) for channel in ("body", "spool")}
    return {
        "question": name,
        "valve": valve,
        "plan": {
            "seconds": plan.seconds,
            "sample_rate_Hz": plan.sample_rate,
            "noise": plan.noise,
            "excitation": excitation,
        },
        "parameters": {
            one.name: {
                "truth": truth.get(one.name),
                "value": one.value,
                "std": one.standard_deviation,
                "unit": one.unit,
            }
            for one in answer.parameters
        },
        "limit": None
        if limit is None
        else {
            "quantity": limit.quantity,
            "value": limit.value,
            "unit": limit.unit,
            "meaning": limit.meaning,
        },
        "reason": answer.reason,
        "notes": list(answer.notes),
        "effects": [
            {
                "id": one.effect,
                "share": one.share,
                "parameters": dict(one.parameters),
                "verdict": one.verdict,
                "confidence": one.confidence,
                "named": one.right,
            }
            for one in found
        ],
        "record": {
            "body_rms": float(np.sqrt(np.mean(quiet.body**2))),
            "spool_rms": float(np.sqrt(np.mean(quiet.spool**2))),
            "body_peak": peaks["body"],
            "spool_peak": peaks["spool"],
            "travel_m": travel(quiet),
            "range_g": _range(max(peaks.values())),
        },
    }


def _range(peak: float) -> float:
    """Return the accelerometer's range, g, that holds ``peak`` (m/s^2) with ``MARGIN``; NaN: none does."""
    return next((float(one) for one in RANGES if one * G >= MARGIN * peak), math.nan)


def _show(result: dict[str, Any], answer: Answer, found: Sequence[Named]) -> None:
    record, plan = result["record"], result["plan"]
    print(
        f"planned: {plan['seconds']:g} s of {plan['excitation']} at {plan['sample_rate_Hz']:g} Hz, "
        f"sensors with {plan['noise']:g} m/s^2 of noise"
    )
    print(
        f"body {record['body_rms']:.3g} m/s^2 rms, spool {record['spool_rms']:.3g} m/s^2 rms and "
        f"{record['spool_peak']:.3g} m/s^2 at most: sensors of {record['range_g']:g} g; the spool moves "
        f"{1e3 * record['travel_m']:.3g} mm from its centre"
    )
    if answer.parameters:
        print(LEGEND)
    for one in answer.parameters:
        truth = (answer.truth or {}).get(one.name)
        beside = "" if truth is None else f"   (simulated: {number(truth)} {one.unit})"
        print(f"  {one.name.replace('_', ' '):<28} {_with_interval(one)}{beside}")
    if answer.limit is not None:
        limit = answer.limit
        value = percent(limit.value) if limit.unit == "1" else f"{number(limit.value)} {limit.unit}"
        print(f"{limit.meaning}: {value}")
    elif answer.reason is None and not found:
        print("no limit: what the record tells stands above")
    if answer.reason is not None:
        print(f"such a record does not tell: {answer.reason}")
    for note in answer.notes:
        print(note)
    for tried in found:
        said = "named" if tried.right else f"not named, but {tried.verdict}"
        own = ", ".join(f"{key} {number(value)}" for key, value in tried.parameters.items())
        print(f"  {tried.effect:<20} that changes {percent(tried.share)} of the motion: {said} ({own})")
    print("noise alone is counted: what no model knows of a real valve comes on top")


def _with_interval(one: Quantity) -> str:
    return with_interval(one.value, one.standard_deviation, one.unit)
