"""Simulation of one valve into a bag."""

from __future__ import annotations

import math
from pathlib import Path

from spool_bag.format.definitions import ACCELERATION_BLOCK, TEMPERATURE
from spool_bag.names import check_valve
from spool_bag.recording.writer import BagWriter
from spool_core.errors import InputError
from spool_core.format.cdr import OilTemperature, encode_block, encode_temperature
from spool_core.text.sentence import plural
from spool_sim.excitation.kinds import Recorded
from spool_sim.sensors import Sensor, Sensors, load_sensors
from spool_sim.simulator import Simulator
from spool_sim.valve.description import find_valve

from spool_tools.console.outputs import making_room
from spool_tools.console.progress import progress
from spool_tools.input.bag_valve import VALVE_DESCRIPTION, encode_valve
from spool_tools.input.recorded_excitation import find_excitation

#: 2025-01-01 UTC: a simulated record has no time of its own.
SIMULATION_START = 1_735_689_600_000_000_000
SIMULATION_SECONDS = 40.0


def simulate(
    out: Path,
    valve: str,
    model: str,
    excitation: str,
    seconds: float | None,
    *,
    sample_rate: float,
    block_rate: float,
    coulomb_force: float | None,
    noise: float,
    seed: int,
    name: str,
    sensors: Path | None = None,
    oil_temperature: str | None = None,
) -> None:
    """Write a simulated record of one valve, with the valve's description, as a bag.

    ``seconds`` left out is the length of a recorded excitation, else ``SIMULATION_SECONDS``; ``sensors`` is
    a YAML file that takes the place of ``noise``; ``oil_temperature`` (deg C) left out is the valve file's,
    and ``"20:60"`` warms the oil over the record; where it is given it is recorded.
    """
    check_valve(name)
    if not (block_rate > 0.0 and 0.5 < sample_rate / block_rate < math.inf):
        raise InputError(
            f"--block-rate {block_rate:g} Hz at --sample-rate {sample_rate:g} Hz: "
            "use a number above 0 and not above the sample rate"
        )
    noisy = Sensor(noise=noise)
    measured = Sensors(body=noisy, spool=noisy) if sensors is None else load_sensors(sensors)
    shaking = find_excitation(excitation)
    if seconds is None:
        seconds = shaking.duration if isinstance(shaking, Recorded) else SIMULATION_SECONDS
    described = find_valve(valve)
    temperatures = _temperatures(oil_temperature)
    simulator = Simulator(
        described.at(temperatures[0]) if len(temperatures) == 1 else described,
        shaking,
        model=model,
        coulomb_force=coulomb_force,
        sample_rate=sample_rate,
        block_size=round(sample_rate / block_rate),
        seed=seed,
        start_stamp=SIMULATION_START,
        body_sensor=measured.body,
        spool_sensor=measured.spool,
    )
    if len(temperatures) == 2:
        simulator.set_drift("oil_temperature", temperatures[0])
        simulator.set_drift("oil_temperature", temperatures[1], seconds)
    blocks = simulator.records(seconds)
    valve_id = simulator.valve.id
    count = 0
    with making_room(out), BagWriter(out, staged=True) as writer, progress("simulating", seconds) as advance:
        description = writer.add_topic(f"/{name}/valve", VALVE_DESCRIPTION)
        channel = writer.add_topic(f"/{name}/acceleration", ACCELERATION_BLOCK)
        writer.write(description, SIMULATION_START, encode_valve(simulator.valve, SIMULATION_START))
        thermal = writer.add_topic(f"/{name}/oil_temperature", TEMPERATURE) if temperatures else 0
        for block in blocks:
            if temperatures and block.sequence % max(1, round(block_rate)) == 0:
                share = (block.stamp - SIMULATION_START) * 1e-9 / seconds
                celsius = temperatures[0] * (1.0 - share) + temperatures[-1] * share
                item = OilTemperature(block.stamp, celsius)
                writer.write(thermal, block.stamp, encode_temperature(item, valve_id))
            writer.write(channel, block.stamp, encode_block(block, valve_id), sequence=block.sequence)
            count += 1
            advance(block.body.size * block.sample_period)
    print(f"{out}: {plural(count, 'block')} of {valve_id} in /{name}, {seconds:g} s at {sample_rate:g} Hz")


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
