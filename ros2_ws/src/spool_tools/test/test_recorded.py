from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from spool_bag.metadata import ACCELERATION_BLOCK
from spool_bag.reader import BagReader
from spool_bag.writer import BagWriter
from spool_core.cdr import encode_block
from spool_core.errors import InputError
from spool_report.records.record_sources import recorded_valve
from spool_report.records.simulation import find_excitation
from spool_sim.excitation import PRESETS, Recorded
from spool_sim.simulator import Simulator
from spool_sim.valve import find_valve
from spool_tools.cli import main

BAGS = Path(__file__).resolve().parents[4] / "bags"


def spool_of(bag: Path) -> NDArray[np.float64]:
    return np.concatenate([block.spool for block in BagReader(bag).blocks("valve_1")]).astype(np.float64)


def write(path: Path, *, skip: int | None = None, names: tuple[str, ...] = ("valve_1",)) -> Path:
    simulator = Simulator(find_valve("4weh10_soft"), PRESETS["sweep"])
    with BagWriter(path) as writer:
        channels = [writer.add_topic(f"/{name}/acceleration", ACCELERATION_BLOCK) for name in names]
        for block in simulator.records(2.0):
            if block.sequence != skip:
                for channel in channels:
                    writer.write(channel, block.stamp, encode_block(block, "v"), sequence=block.sequence)
    return path


def test_recorded_body_moves_the_spool_as_the_record_says(tmp_path: Path) -> None:
    """The record comes from another simulator, so the spool's motion in it is an independent answer."""
    model = tmp_path / "model.yaml"
    model.write_text(
        "name: practice\nterms: [inertia, spring, viscous_friction]\n"
        "parameters: {viscous_coefficient: 4.0}\n",
        "utf-8",
    )
    out = tmp_path / "out"
    arguments = ["--model", str(model), "--excitation", str(BAGS / "practice_01"), "--noise", "0"]
    assert main(["simulate", *arguments, "--out", str(out)]) == 0
    ours, theirs = spool_of(out), spool_of(BAGS / "practice_01")
    # The record's length is taken, to whole blocks.
    assert abs(ours.size - theirs.size) <= 40
    size = min(ours.size, theirs.size)
    settled = slice(2000, size - 100)
    error = np.sqrt(np.mean((ours[settled] - theirs[settled]) ** 2))
    # Both accelerations carry 0.03 m/s^2 of noise; resonance passes the body's on threefold.
    assert error < 0.1
    assert theirs[settled].std() > 50.0 * error


def test_bag_csv_and_yaml_give_the_same_excitation(tmp_path: Path) -> None:
    bag = write(tmp_path / "bag")
    csv = tmp_path / "record.csv"
    assert main(["export", str(bag), "--out", str(csv)]) == 0
    described = tmp_path / "excitation.yaml"
    described.write_text("kind: recorded\nfile: bag\nvalve: valve_1\n", "utf-8")
    one, other = find_excitation(str(bag)), find_excitation(str(described))
    assert isinstance(one, Recorded)
    assert isinstance(other, Recorded)
    np.testing.assert_array_equal(one.samples, other.samples)
    assert one.sample_rate == other.sample_rate == 2000.0
    assert one.samples.size == 4000
    rows = "\n".join(f"{n / 2000.0},{value!r},0.0" for n, value in enumerate(one.samples.tolist()))
    csv.write_text("time_s,body_m_s2,spool_m_s2\n" + rows + "\n", "utf-8")
    third = find_excitation(str(csv))
    assert isinstance(third, Recorded)
    np.testing.assert_allclose(third.samples, one.samples, rtol=1e-12)
    assert third.sample_rate == pytest.approx(2000.0)


def test_presets_and_yaml_files_still_are_what_they_were(tmp_path: Path) -> None:
    assert find_excitation("sweep") is PRESETS["sweep"]
    path = tmp_path / "excitation.yaml"
    path.write_text("kind: steady_sine\nfrequency: 20\namplitude: 3\n", "utf-8")
    assert find_excitation(str(path)).highest_frequency == 20.0
    with pytest.raises(InputError, match="no such excitation"):
        find_excitation("sweeep")


def test_record_with_lost_blocks_is_refused_with_the_place(tmp_path: Path) -> None:
    bag = write(tmp_path / "bag", skip=10)
    with pytest.raises(InputError, match=r"/valve_1/acceleration: blocks lost .* at 0\.220 s: .* gaps"):
        find_excitation(str(bag))


def test_one_of_several_valves_has_to_be_named(tmp_path: Path) -> None:
    bag = write(tmp_path / "bag", names=("left", "right"))
    with pytest.raises(InputError, match=r"its valves are left, right; name one .*kind: recorded"):
        find_excitation(str(bag))
    described = tmp_path / "excitation.yaml"
    described.write_text(f"kind: recorded\nfile: {bag}\nvalve: right\nsoft_start: 0.5\n", "utf-8")
    assert find_excitation(str(described)).soft_start == 0.5
    described.write_text(f"kind: recorded\nfile: {bag}\nvalve: up\n", "utf-8")
    with pytest.raises(InputError, match="no valve 'up': the bag has left, right"):
        find_excitation(str(described))


def test_wrong_yaml_of_a_record_is_refused_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "excitation.yaml"
    path.write_text("kind: recorded\nfilee: bag\n", "utf-8")
    assert main(["simulate", "--excitation", str(path), "--out", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err
    assert "excitation.yaml: file: key is missing" in said
    assert "filee: unknown key" in said
    assert said.count("\n") == 1


def test_oil_temperature_sets_the_viscosity_and_is_recorded(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    given = ["simulate", "--seconds", "1", "--oil-temperature", "60"]
    assert main([*given, "--out", str(out)]) == 0
    recorded = recorded_valve(BagReader(out), "valve_1")
    assert recorded is not None
    valve = find_valve("4weh10_soft")
    assert recorded.oil_temperature == 60.0
    assert recorded.viscous_coefficient == pytest.approx(valve.at(60.0).viscous_coefficient)
    capsys.readouterr()
    assert main([*given[:-1], "200", "--out", str(tmp_path / "hot")]) == 2
    assert "oil temperature: 200 deg C is out of range for HL68" in capsys.readouterr().err


def test_oil_that_warms_is_recorded_with_the_valve(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    given = ["simulate", "--seconds", "4", "--out", str(out), "--oil-temperature"]
    assert main([*given, "20:60"]) == 0
    reader = BagReader(out)
    recorded = recorded_valve(reader, "valve_1")
    assert recorded == find_valve("4weh10_soft")
    assert [round(celsius, 6) for _, celsius in reader.temperatures("valve_1")] == [20.0, 30.0, 40.0, 50.0]
    capsys.readouterr()
    assert main([*given, "warm"]) == 2
    assert "write it like 40, or 20:60" in capsys.readouterr().err


def test_sensor_file_reaches_the_record(tmp_path: Path) -> None:
    path = tmp_path / "sensors.yaml"
    path.write_text("spool: {full_scale: 4.0, delay_samples: 1.5}\n", "utf-8")
    out = tmp_path / "out"
    assert main(["simulate", "--sensors", str(path), "--seconds", "4", "--out", str(out)]) == 0
    assert np.abs(spool_of(out)).max() == pytest.approx(4.0)
