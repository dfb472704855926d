"""Gap analysis of a record: what the base model lacks in it."""

from __future__ import annotations

from spool_estimator.identification.record import LARGEST
from spool_gap.evidence.analyse import analyse
from spool_gap.report import result_to_dict
from spool_gap.result import GapSettings
from spool_report.records.record_loading import check, load_recordings, stretches_of
from spool_report.requests import Selection
from spool_sim.model import load_model

from spool_fleet.analyses import Analysis, Rows, Subject, parameter

BASE = "fluid"


def run(subject: Subject) -> Rows:
    """Return the verdict on ``subject``.

    Raises:
        InputError: the record is too short or not excited.
    """
    selection = Selection(subject.namespace, longest=LARGEST, described=subject.valve_file is None)
    recordings, valve = load_recordings([subject.path], subject.valve_file, selection)
    for recording in recordings:
        check(recording)
    found = result_to_dict(analyse(stretches_of(recordings), valve, load_model(BASE), settings=GapSettings()))
    gap = found["gap"]
    row = [found["verdict"], found["confidence"], gap["before"]["nrmse"], gap["after"]["nrmse"]]
    parameters = [
        parameter("gap", BASE, name, quantity)
        for effect in found["effects"]
        for name, quantity in effect["parameters"].items()
    ]
    return {"gaps": [row], "parameters": parameters}


ANALYSIS = Analysis("gap", run, "verdict of the model-gap workflow")
