"""Evidence of reports: what is drawn follows closed forms, and says how well it is known."""

from __future__ import annotations

import functools

import matplotlib.pyplot as plt
import numpy as np
import pytest
from spool_estimator.identification.record import Record
from spool_monitor.drift_trace import DriftPoint
from spool_report import page as html
from spool_report.evidence.collection import AccelerationEvidence
from spool_report.evidence.drifts import drift
from spool_report.evidence.exhibit import POINTS, Exhibit, LeftOut
from spool_report.evidence.motion import Numbers, loops_of, step_at_zero
from spool_report.evidence.spectra import cross_spectra
from spool_sim.excitation import Multisine
from spool_sim.model import load_model
from spool_sim.sensors import Sensor
from spool_sim.simulator import Simulator
from spool_sim.valve import find_valve

VALVE = find_valve("4weh10_soft")
PERIOD = 1.0 / 2000.0
#: Lines so close to each other that pieces of 2 s see a continuous spectrum.
BROADBAND = Multisine(low_frequency=5.0, high_frequency=100.0, lines=1000, rms=7.0, period=60.0)
LINEAR = {
    "mass": VALVE.moving_mass,
    "viscous_coefficient": VALVE.viscous_coefficient,
    "spring_stiffness": VALVE.spring_stiffness,
}


@functools.cache
def record(
    seconds: float, *, model: str = "fluid", seed: int = 0, noise: float = 0.05, **values: float
) -> Record:
    """Return a simulated record of the soft valve, shaken by many sines."""
    sensor = Sensor(noise=noise)
    simulator = Simulator(
        VALVE, BROADBAND, model=model, parameters=values, seed=seed, body_sensor=sensor,
        spool_sensor=sensor,
    )  # fmt: skip
    blocks = list(simulator.records(seconds))
    body, spool = (
        np.concatenate([getattr(block, name) for block in blocks]).astype(np.float64)
        for name in ("body", "spool")
    )
    return Record("simulated", blocks[0].stamp, PERIOD, body, spool)


def sides(*names: str, **values: float) -> list[Numbers]:
    found = []
    for name in names:
        model = load_model(name)
        found.append(Numbers(name, model, {**model.values_for(VALVE), **values}))
    return found


def test_the_transmissibility_of_a_linear_valve_is_the_closed_form_within_its_error() -> None:
    one = record(30.0)
    spectra = cross_spectra([one.body], [one.spool], PERIOD)
    told = spectra.excited & (spectra.coherence > 0.9) & (spectra.frequency > 3.0)
    mass, damping, stiffness = LINEAR.values()
    omega = 2.0 * np.pi * spectra.frequency
    force = stiffness + 1j * omega * damping
    closed = force / (force - mass * omega**2)
    apart = np.abs(spectra.response / closed - 1.0)[told]
    assert told.sum() > 30
    # Both errors, in line and across: 95 % of a Rayleigh distribution lies below 2.45 standard deviations.
    # A piece of 2 s smooths the resonance by half a per cent at its peak.
    inside = apart < 2.45 * spectra.relative_error[told] + 0.005
    assert inside.mean() > 0.9


def test_the_error_of_a_transmissibility_is_what_repetitions_scatter_by() -> None:
    draw = np.random.default_rng(3)
    ratios, errors = [], []
    for _ in range(60):
        drive, noise = draw.standard_normal((2, 6000))
        spectra = cross_spectra([drive], [0.5 * drive + 0.5 * noise], 1e-3)
        place = spectra.frequency.size // 3
        ratios.append(abs(spectra.response[place]) / 0.5)
        errors.append(float(spectra.relative_error[place]))
    assert np.std(ratios) == pytest.approx(np.mean(errors), rel=0.35)


def test_a_short_peak_of_a_long_record_is_drawn_and_the_legend_names_each_look_once() -> None:
    points = [
        DriftPoint(at * 1_000_000_000, 2.5, 0.01, 2.5, 0.01, 0.2, 0.0, 60.0 if at == 7001 else 1.0, 0.0, 50.0)
        for at in range(20_000)
    ]
    found = drift("viscous_coefficient", "N s/m", points, 0, ())
    try:
        assert "first crosses its threshold at 7001 s" in found.seen
        upper, lower = found.panels
        assert lower.x.size <= POINTS
        (peak,) = lower.x[lower.lines[0].values > 50.0]
        assert peak == 7001.0
        legend = found.figure.axes[0].get_legend()
        names = [text.get_text() for text in legend.get_texts()]
        assert names == ["baseline", "change that matters", "alarm", "estimate"]
        found.figure.draw_without_rendering()
        assert legend.get_window_extent().y0 >= found.figure.axes[0].bbox.y1, "above the lines"
        assert len(upper.lines) == 6
    finally:
        plt.close(found.figure)


def test_missing_dry_friction_is_a_step_at_velocity_zero_of_twice_its_size() -> None:
    one = record(12.0, model="coulomb", coulomb_force=0.5, noise=0.02)
    loops = loops_of([one], sides("fluid", "coulomb", coulomb_force=0.5))
    assert step_at_zero(loops.over_velocity["fluid"]) == pytest.approx(1.0, rel=0.25)
    assert abs(step_at_zero(loops.over_velocity["coulomb"])) < 0.1
    assert loops.missing["coulomb"] < 0.3 * loops.missing["fluid"]


def shown(records: list[Record], *names: str) -> list[Exhibit | LeftOut]:
    return AccelerationEvidence(records, VALVE, sides(*names)).exhibits()


@pytest.mark.parametrize("case", ["short", "stuck", "no_temperature", "silent", "nothing"])
def test_no_record_keeps_a_report_from_being_written(case: str) -> None:
    made_of = {
        "short": lambda: [record(0.3)],
        "stuck": lambda: [Record("stuck", 0, PERIOD, *np.repeat(record(8.0).body[np.newaxis], 2, axis=0))],
        "no_temperature": lambda: [record(8.0)],
        "silent": lambda: [Record("silent", 0, PERIOD, np.zeros(16000), np.zeros(16000))],
        "nothing": list,
    }[case]
    items = shown(made_of(), "fluid", "coulomb")
    assert len(items) == 3
    text = " ".join(html.evidence(items))
    for item in items:
        assert item.title in text
        assert (item.reason if isinstance(item, LeftOut) else item.seen).strip()
    drawn = [item for item in items if isinstance(item, Exhibit)]
    assert len(drawn) == {"short": 1, "no_temperature": 3, "nothing": 0}.get(case, len(drawn))
