"""Records of a valve that its solenoid switches."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from spool_report.records.record_loading import load_data
from spool_report.requests import Selection
from spool_sim.excitation import MachineOrders
from spool_sim.simulator import Simulator
from spool_sim.strokes import Strokes
from spool_sim.valve import find_valve

MACHINE = MachineOrders(
    speed_profile=((0.0, 1440.0),), orders=((1.0, 5.0), (2.0, 1.75)), broadband_rms=1.0, broadband_low=6.0,
    broadband_high=120.0, broadband_lines=40, seed=3,
)  # fmt: skip


def table(path: Path, strokes: Strokes | None) -> Path:
    simulator = Simulator(
        find_valve("4weh10_soft"), MACHINE, coulomb_force=0.1, sample_rate=1000.0,
        block_size=20, strokes=strokes,
    )  # fmt: skip
    blocks = list(simulator.records(20.0))
    rows = np.concatenate([np.stack((one.body, one.spool)) for one in blocks], axis=1).T
    time = np.arange(len(rows)) * 1e-3
    np.savetxt(
        path, np.column_stack((time, rows)), delimiter=",", header="time_s,body_m_s2,spool_m_s2", comments=""
    )
    return path


def test_strokes_are_left_out_of_what_is_fitted_with_a_sentence(tmp_path: Path) -> None:
    strokes = Strokes(period=6.0, first=4.5, hold=1.0, force=30.0)
    data = load_data([table(tmp_path / "a.csv", strokes)], "4weh10_soft", Selection())
    assert any("the valve was switched: " in one and "left out" in one for one in data.doubts)
    for part in (*data.fitted, *data.held_out):
        first = (part.start - data.fitted[0].start) * 1e-9
        for stroke in (4.5, 10.5, 16.5):
            assert first + part.duration <= stroke + 0.02 or first >= stroke + 1.0
    kept = sum(part.duration for part in (*data.fitted, *data.held_out))
    assert 12.0 < kept < 16.0


def test_a_record_without_strokes_is_taken_whole(tmp_path: Path) -> None:
    data = load_data([table(tmp_path / "a.csv", None)], "4weh10_soft", Selection())
    assert not any("switched" in one for one in data.doubts)
    assert sum(part.duration for part in (*data.fitted, *data.held_out)) == 20.0
