"""Analyses of one record of one valve."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from spool_bag.information import Timeline
from spool_bag.reader import BagReader
from spool_core.errors import InputError
from spool_core.text import did_you_mean
from spool_core.uncertainty import as_json
from spool_estimator.identification.fit_result import FitSettings
from spool_estimator.identification.record import LARGEST
from spool_estimator.identification.spectra import cross_spectrum, noise_of
from spool_estimator.record_judgement import Analysis, resonance_of, shortness
from spool_gap.evidence.analyse import analyse
from spool_gap.report import result_to_dict
from spool_gap.result import GapSettings
from spool_report.fit_tables import to_dictionary
from spool_report.ranking import fit_and_validate
from spool_report.records.record_loading import (
    check,
    choose_valves,
    load_data,
    load_recording,
    load_recordings,
    stretches_of,
)
from spool_report.requests import Selection
from spool_report.runs.record_replay import SHIPPED, ReplaySettings, replay_valve, valve_dictionary
from spool_sim.model import load_model
from spool_sim.valve import Valve

from spool_fleet.manifest import Rows
from spool_fleet.parquet import REFERENCE, REFERRED

#: Models that are fitted, and that something may be missing from.
FITTED, BASE = "coulomb", "fluid"
#: Samples that are read of a record at most: ten minutes at 2 kHz say all that a fit can, and bound memory.
LONGEST = 1_200_000
#: s of data on which the effect of the excitation's noise is simulated: a bias of a hundredth of a standard
#: deviation in a minute's record, for which a quarter of the default's time does.
NOISE_SECONDS = 10.0
#: s of a segment of Welch's method: 0.5 Hz between two lines.
SEGMENT = 2.0
#: Keys of an event that are columns of the table ``events``, in their order.
EVENT = ("t_s", "kind", "state", "severity", "cause", "value", "unit", "message")


@dataclass(frozen=True, slots=True)
class Subject:
    """Record that is analysed: the valve ``namespace`` of the bag at ``path``, described by ``valve_file``.

    ``valve_file`` is a file or a shipped valve's name; ``None``: the bag describes its valve. ``settings``
    are those of a replay; ``None``: the shipped ones.
    """

    path: Path
    namespace: str
    valve_file: str | None = None
    settings: ReplaySettings | None = None

    def selection(self, longest: int) -> Selection:
        """Return what is read of the record, at most ``longest`` samples."""
        return Selection(self.namespace, longest=longest, described=self.valve_file is None)


def chosen(text: str) -> tuple[str, ...]:
    """Return the names in ``text``, separated by commas.

    Raises:
        InputError: there is no such analysis.
    """
    names = tuple(dict.fromkeys(name.strip() for name in text.split(",") if name.strip()))
    known = ", ".join(ANALYSES)
    for name in names:
        if name not in ANALYSES:
            raise InputError(f"--analysis {name}: known are {known}{did_you_mean(name, list(ANALYSES))}")
    if not names:
        raise InputError(f"--analysis: name one or more of {known}")
    return names


def features(subject: Subject) -> Rows:
    """Return rms, crest factor and kurtosis of both channels, and the resonance of their transmissibility.

    They need no model of the valve.

    Raises:
        InputError: the record has no second of samples without a gap.
    """
    selection = Selection(subject.namespace, longest=LONGEST, described=False)
    recording = load_recording(subject.path, selection)
    longest = max(recording.stretches, key=lambda stretch: stretch.duration)
    short = shortness(Analysis.ESTIMATE, [longest.duration])
    if short:
        raise InputError(short)
    found = []
    for channel in ("body", "spool"):
        row = np.concatenate([getattr(stretch, channel) for stretch in recording.stretches])
        around = row - row.mean()
        power = float(np.mean(around**2))
        rms = power**0.5
        crest = float(np.abs(around).max()) / rms if rms > 0.0 else float("nan")
        kurtosis = float(np.mean(around**4)) / power**2 if power > 0.0 else float("nan")
        shape = (("rms", rms, "m/s^2"), ("crest_factor", crest, "1"), ("kurtosis", kurtosis, "1"))
        found += [(f"{channel}_{name}", value, unit) for name, value, unit in shape]
    length = min(longest.body.size, round(SEGMENT * longest.sample_rate))
    both = cross_spectrum(longest.body, longest.spool, longest.sample_rate, length)
    noise = noise_of(longest.body, longest.spool, longest.sample_rate)
    frequency, height = resonance_of(both, noise)
    # A single segment is coherent throughout.
    if longest.body.size >= 2 * length and math.isfinite(frequency):
        found += [
            ("transmissibility_peak_frequency", frequency, "Hz"),
            ("transmissibility_peak", height, "1"),
        ]
    rows = [_parameter("features", "", name, {"value": value, "unit": unit}) for name, value, unit in found]
    return {"parameters": rows}


def fit(subject: Subject) -> Rows:
    """Return the parameters of the model with Coulomb friction.

    Raises:
        InputError: the record is too short, not excited, or the fit has no result.
    """
    model = load_model(FITTED)
    data = load_data([subject.path], subject.valve_file, subject.selection(LONGEST))
    found = to_dictionary(fit_and_validate(data, model, FitSettings(noise_seconds=NOISE_SECONDS)))
    if found["reason"] is not None:
        raise InputError(str(found["reason"]))
    known = {k: one for k, one in found["parameters"].items() if k not in found["not_observable"]}
    rows = _of_model("fit", FITTED, found, known)
    drag = found["parameters"].get("viscous_coefficient")
    if drag is not None and all(record.oil_temperature is not None for record in data.fitted):
        rows += _referred("fit", FITTED, data.valve, drag)
    return {"parameters": rows}


def gap(subject: Subject) -> Rows:
    """Return the verdict on what the base model lacks.

    Raises:
        InputError: the record is too short or not excited.
    """
    recordings, valve = load_recordings([subject.path], subject.valve_file, subject.selection(LARGEST))
    for recording in recordings:
        check(recording)
    found = result_to_dict(analyse(stretches_of(recordings), valve, load_model(BASE), settings=GapSettings()))
    errors = found["gap"]
    row = [found["verdict"], found["confidence"], errors["before"]["nrmse"], errors["after"]["nrmse"]]
    parameters = [
        _parameter("gap", BASE, name, quantity)
        for effect in found["effects"]
        for name, quantity in effect["parameters"].items()
    ]
    return {"gaps": [row], "parameters": parameters}


def monitor(subject: Subject) -> Rows:
    """Return what estimator and monitor find in a replay: the last estimate and the events.

    Raises:
        InputError: the bag cannot be replayed, or nothing describes its valve.
    """
    reader, name, timeline = BagReader(subject.path), subject.namespace, Timeline()
    files = [f"{name}={subject.valve_file}"] if subject.valve_file else []
    valve = choose_valves(reader, [name], files)[name]
    if valve.source == "assumed":
        raise InputError("the bag does not describe its valve: give --valve to `./spool fleet add`")
    settings = subject.settings or SHIPPED
    replayed = replay_valve(reader, name, valve.valve, settings, timeline=timeline)
    first = timeline.spans[0].first if timeline.spans else 0
    one = valve_dictionary(replayed, timeline, first, valve, settings.to_dict(), [])
    estimate, latest = one["estimate"], replayed.estimator.latest
    model = estimate["model"] or ""
    rows = _of_model("monitor", model, estimate, estimate["parameters"])
    if latest is not None and latest.referred_viscous_coefficient.known:
        drag = as_json(latest.referred_viscous_coefficient)
        rows += _referred("monitor", model, valve.valve, drag)
    return {"parameters": rows, "events": [[event[key] for key in EVENT] for event in one["events"]]}


#: Analyses by name: each returns rows by table, without the columns that say which record it is, and raises
#: InputError with the reason where the record does not allow it.
ANALYSES: dict[str, Callable[[Subject], Rows]] = {
    "features": features, "fit": fit, "gap": gap, "monitor": monitor,
}  # fmt: skip


def _of_model(
    analysis: str, model: str, found: dict[str, Any], parameters: dict[str, dict[str, Any]]
) -> list[list[Any]]:
    """Return rows of the ``parameters`` and of the numbers that a model gives besides."""
    rows = [_parameter(analysis, model, name, quantity) for name, quantity in parameters.items()]
    for name, unit in (("natural_frequency_Hz", "Hz"), ("damping_ratio", "1"), ("nrmse", "1")):
        quantity = {"value": found[name], "unit": unit}
        rows.append(_parameter(analysis, model, name.removesuffix("_Hz"), quantity))
    return rows


def _parameter(analysis: str, model: str, name: str, quantity: dict[str, Any]) -> list[Any]:
    """Return a row of the table ``parameters`` from a quantity as JSON has it."""
    return [analysis, model, name, quantity.get("value"), quantity.get("std"), quantity.get("unit", "")]


def _referred(analysis: str, model: str, valve: Valve, quantity: dict[str, Any]) -> list[list[Any]]:
    """Return the row of a viscous coefficient at ``REFERENCE``; given is that at the valve's temperature.

    There is none where the valve names no oil, or its law does not reach so far.
    """
    try:
        ratio = valve.dynamic_viscosity_at(REFERENCE) / valve.dynamic_viscosity
    except InputError:
        return []
    scaled = {name: ratio * quantity[name] for name in ("value", "std") if quantity[name] is not None}
    return [_parameter(analysis, model, REFERRED, {**quantity, **scaled})]
