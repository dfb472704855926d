"""Fit of the model with Coulomb friction to a record."""

from __future__ import annotations

from spool_core.errors import InputError
from spool_estimator.identification.fit_result import FitSettings
from spool_report.fit_tables import to_dictionary
from spool_report.ranking import fit_and_validate
from spool_report.records.record_loading import load_data
from spool_report.requests import Selection
from spool_sim.model import load_model

from spool_fleet.analyses import Analysis, Rows, Subject, parameter, referred

MODEL = "coulomb"
#: Samples that are read of a record at most: ten minutes at 2 kHz say all that a fit can, and bound memory.
LONGEST = 1_200_000
#: s of data on which the effect of the excitation's noise is simulated: a bias of a hundredth of a standard
#: deviation in a minute's record, for which a quarter of the default's time does.
NOISE_SECONDS = 10.0


def run(subject: Subject) -> Rows:
    """Return the fitted parameters of ``subject``.

    Raises:
        InputError: the record is too short, not excited, or the fit has no result.
    """
    model = load_model(MODEL)
    selection = Selection(subject.namespace, longest=LONGEST, described=subject.valve_file is None)
    data = load_data([subject.path], subject.valve_file, selection)
    found = to_dictionary(fit_and_validate(data, model, FitSettings(noise_seconds=NOISE_SECONDS)))
    if found["reason"] is not None:
        raise InputError(str(found["reason"]))
    rows = [
        parameter("fit", MODEL, name, quantity)
        for name, quantity in found["parameters"].items()
        if name not in found["not_observable"]
    ]
    for name, unit in (("natural_frequency_Hz", "Hz"), ("damping_ratio", "1"), ("nrmse", "1")):
        rows.append(parameter("fit", MODEL, name.removesuffix("_Hz"), {"value": found[name], "unit": unit}))
    drag = found["parameters"].get("viscous_coefficient")
    if drag is not None and all(record.oil_temperature is not None for record in data.fitted):
        rows += referred("fit", MODEL, data.valve, drag)
    return {"parameters": rows}


ANALYSIS = Analysis("fit", run, "parameters with intervals of the model with Coulomb friction")
