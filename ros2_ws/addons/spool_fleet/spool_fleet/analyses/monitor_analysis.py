"""Replay of a record through estimator and monitor: last estimate and events."""

from __future__ import annotations

from spool_bag.information import Timeline
from spool_bag.reader import BagReader
from spool_core.errors import InputError
from spool_core.uncertainty import as_json
from spool_report.records.record_loading import choose_valves
from spool_report.runs.record_replay import SHIPPED, replay_valve, valve_dictionary

from spool_fleet.analyses import Analysis, Rows, Subject, parameter, referred

EVENT = ("t_s", "kind", "state", "severity", "cause", "value", "unit", "message")


def run(subject: Subject) -> Rows:
    """Return what the monitor says of ``subject``, and the last estimate.

    Raises:
        InputError: the bag cannot be replayed, or nothing describes its valve.
    """
    reader, name, timeline = BagReader(subject.path), subject.namespace, Timeline()
    files = [f"{name}={subject.valve_file}"] if subject.valve_file else []
    chosen = choose_valves(reader, [name], files)[name]
    if chosen.source == "assumed":
        raise InputError("the bag does not describe its valve: give --valve to `./spool fleet add`")
    settings = subject.settings or SHIPPED
    replayed = replay_valve(reader, name, chosen.valve, settings, timeline=timeline)
    first = timeline.spans[0].first if timeline.spans else 0
    one = valve_dictionary(replayed, timeline, first, chosen, settings.to_dict(), [])
    estimate, latest = one["estimate"], replayed.estimator.latest
    model = estimate["model"] or ""
    rows = [parameter("monitor", model, name, value) for name, value in estimate["parameters"].items()]
    for name, unit in (("natural_frequency_Hz", "Hz"), ("damping_ratio", "1"), ("nrmse", "1")):
        quantity = {"value": estimate[name], "unit": unit}
        rows.append(parameter("monitor", model, name.removesuffix("_Hz"), quantity))
    if latest is not None and latest.referred_viscous_coefficient.known:
        drag = as_json(latest.referred_viscous_coefficient)
        rows += referred("monitor", model, chosen.valve, drag)
    return {"parameters": rows, "events": [[event[key] for key in EVENT] for event in one["events"]]}


ANALYSIS = Analysis("monitor", run, "estimate and events of the monitor, from a replay")
