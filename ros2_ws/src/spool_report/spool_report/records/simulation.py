"""`./spool simulate`: one valve into a bag, excited by a preset or by what a record holds."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError
from spool_bag import BODY, check_valve
from spool_bag.importing.bag_import import SPEED_INTERVAL
from spool_bag.metadata import ACCELERATION_BLOCK, FLOAT64, TEMPERATURE, is_bag_file
from spool_bag.reader import BagReader
from spool_bag.writer import BagWriter
from spool_core.block_gate import BlockGate, Verdict
from spool_core.cdr import OilTemperature, Speed, encode_block, encode_speed, encode_temperature
from spool_core.errors import InputError
from spool_core.numbers import Array
from spool_core.text import plural
from spool_report.outputs import making_room
from spool_report.records.record_sources import VALVE_DESCRIPTION, encode_valve, is_table, record_of_table
from spool_report.requests import SimulationSettings
from spool_report.terminal import progress
from spool_sim.excitation import PRESETS, Excitation, Recorded, load_excitation
from spool_sim.valve import find_valve, one_line, read_mapping

#: 2025-01-01 UTC: a simulated record has no real time.
SIMULATION_START = 1_735_689_600_000_000_000
SIMULATION_SECONDS = 40.0


def simulate(out: Path, settings: SimulationSettings) -> None:
    """Write a simulated record of one valve, with the valve's description, as the bag ``out``.

    Raises:
        InputError: a setting is out of range, or what it names cannot be used.
    """
    name, seconds = settings.name, settings.seconds
    sample_rate, block_rate = settings.sample_rate, settings.block_rate
    check_valve(name)
    if not (block_rate > 0.0 and 0.5 < sample_rate / block_rate < math.inf):
        raise InputError(
            f"--block-rate {block_rate:g} Hz at --sample-rate {sample_rate:g} Hz: "
            "use a number above 0 and not above the sample rate"
        )
    shaking = find_excitation(settings.excitation)
    # With numba: what is refused above waits for no compiler.
    from spool_sim import observation, sensors, simulator  # noqa: PLC0415

    noisy = sensors.Sensor(noise=settings.noise, filter=observation.Observation.of(settings.filter))
    measured = sensors.Sensors(body=noisy, spool=noisy)
    if settings.sensors is not None:
        measured = sensors.load_sensors(settings.sensors)
    if seconds is None:
        seconds = shaking.duration if isinstance(shaking, Recorded) else SIMULATION_SECONDS
    described = find_valve(settings.valve)
    temperatures = _temperatures(settings.oil_temperature)
    source = simulator.Simulator(
        described.at(temperatures[0]) if len(temperatures) == 1 else described,
        shaking,
        model=settings.model,
        coulomb_force=settings.coulomb_force,
        sample_rate=sample_rate,
        block_size=round(sample_rate / block_rate),
        seed=settings.seed,
        start_stamp=SIMULATION_START,
        body_sensor=measured.body,
        spool_sensor=measured.spool,
    )
    if len(temperatures) == 2:
        source.set_drift("oil_temperature", temperatures[0])
        source.set_drift("oil_temperature", temperatures[1], seconds)
    blocks = source.records(seconds)
    valve_id = source.valve.id
    count = 0
    both = (("body", measured.body), ("spool", measured.spool))
    custom = {f"{name}/{one}/filter": sensor.filter.sentence(sample_rate) for one, sensor in both}
    with (
        making_room(out),
        BagWriter(out, staged=True, custom=custom) as writer,
        progress("simulating", seconds) as advance,
    ):
        description = writer.add_topic(f"/{name}/valve", VALVE_DESCRIPTION)
        channel = writer.add_topic(f"/{name}/acceleration", ACCELERATION_BLOCK)
        writer.write(description, SIMULATION_START, encode_valve(source.valve, SIMULATION_START))
        thermal = writer.add_topic(f"/{name}/oil_temperature", TEMPERATURE) if temperatures else 0
        shaft = 0 if shaking.speed(0.0) is None else writer.add_topic(f"/{name}/speed", FLOAT64)
        next_speed = SIMULATION_START
        for block in blocks:
            rpm = shaking.speed((block.stamp - SIMULATION_START) * 1e-9)
            if rpm is not None and block.stamp >= next_speed:
                writer.write(shaft, block.stamp, encode_speed(Speed(block.stamp, rpm)))
                next_speed = block.stamp + SPEED_INTERVAL
            if temperatures and block.sequence % max(1, round(block_rate)) == 0:
                share = (block.stamp - SIMULATION_START) * 1e-9 / seconds
                celsius = temperatures[0] * (1.0 - share) + temperatures[-1] * share
                item = OilTemperature(block.stamp, celsius)
                writer.write(thermal, block.stamp, encode_temperature(item, valve_id))
            writer.write(channel, block.stamp, encode_block(block, valve_id), sequence=block.sequence)
            count += 1
            advance(block.duration)
    print(f"{out}: {plural(count, 'block')} of {valve_id} in /{name}, {seconds:g} s at {sample_rate:g} Hz")


def find_excitation(name: str) -> Excitation:
    """Return the excitation ``name``: a preset, a YAML file of any kind, a bag or a logger's file.

    Raises:
        InputError: nothing of that name, or it cannot be used; file and place are named.
    """
    path = Path(name)
    if name in PRESETS:
        return PRESETS[name]
    if path.is_dir() or is_bag_file(path) or is_table(path):
        return recorded_excitation(path)
    if path.is_file():
        mapping = read_mapping(path, "excitation")
        if mapping.get("kind") == "recorded":
            try:
                found = _RecordFile.model_validate(mapping)
            except ValidationError as error:
                raise one_line(error, name, tuple(_RecordFile.model_fields)) from None
            return recorded_excitation(path.parent / found.file, found.valve, found.soft_start)
    return load_excitation(name)


def recorded_excitation(path: Path, valve: str | None = None, soft_start: float = 0.0) -> Recorded:
    """Return the body acceleration of ``valve`` in the bag or file ``path``.

    Args:
        path: rosbag2 directory, .mcap, any file that `import` reads.
        valve: namespace in the bag; may be left out where there is one.
        soft_start: s over which the record is faded in.

    Raises:
        InputError: unreadable, no such valve, several valves and none named, or samples are missing.
    """
    if is_table(path):
        record = record_of_table(path)
        if record.gaps.size:
            raise InputError(
                f"{path}: samples are missing before {record.time[record.gaps[0]]:g} s; cut the record there"
            )
        samples, period = record.columns[BODY], record.period
    else:
        samples, period = _from_bag(path, valve)
    if samples.size < 2:
        raise InputError(f"{path}: {samples.size} samples are too few for an excitation")
    return Recorded(samples=samples, sample_rate=1.0 / period, source=str(path), soft_start=soft_start)


def _temperatures(text: str | None) -> tuple[float, ...]:
    if text is None:
        return ()
    try:
        values = tuple(float(part) for part in text.split(":"))
    except ValueError:
        values = ()
    if not 1 <= len(values) <= 2 or not all(map(math.isfinite, values)):
        raise InputError(f"--oil-temperature {text!r}: write it like 40, or 20:60 for oil that warms")
    return values


class _RecordFile(BaseModel):
    """File of kind ``recorded``: its ``file`` lies next to it, or anywhere by its full path."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    kind: Literal["recorded"]
    file: Path
    valve: str | None = None
    soft_start: Annotated[float, Field(ge=0.0, le=1e6)] = 0.0


def _from_bag(path: Path, valve: str | None) -> tuple[Array, float]:
    reader = BagReader(path)
    if valve is None:
        if len(reader.valves) != 1:
            known = ", ".join(reader.valves) or "none"
            raise InputError(
                f"{path}: its valves are {known}; name one in a YAML file: "
                f"{{kind: recorded, file: {path}, valve: NAME}}"
            )
        valve = reader.valves[0]
    gate = BlockGate()
    parts: list[NDArray[np.float32]] = []
    first, period = 0, 1.0
    for block in reader.blocks(valve):
        verdict = gate.judge(block)
        if not parts:
            first, period = block.stamp, block.sample_period
        if verdict is Verdict.REFUSED or (parts and verdict is not Verdict.CONTINUES):
            reason = ", ".join(fault.value for fault in gate.faults)
            raise InputError(
                f"{path}: /{valve}/acceleration: {reason} at {(block.stamp - first) * 1e-9:.3f} s: "
                "an excitation needs a record without gaps"
            )
        parts.append(block.body)
    if not parts:
        return np.empty(0), period
    return np.concatenate(parts).astype(np.float64), period
