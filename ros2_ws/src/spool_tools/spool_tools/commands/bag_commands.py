"""What the commands do, short of those with a module of their own."""

from __future__ import annotations

import json as json_module
import math
from collections.abc import Mapping, Sequence
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table
from spool_bag.mcap.mcap_walk import Damage
from spool_bag.names import check_valve
from spool_bag.reading.cdr import OilTemperature, encode_block, encode_temperature
from spool_bag.reading.definitions import ACCELERATION_BLOCK, TEMPERATURE
from spool_bag.reading.information import BagInformation, describe
from spool_bag.reading.recovery import recover
from spool_bag.recording.writer import BagWriter
from spool_bag.tables.csv_import import import_csv
from spool_bag.tables.export import export_bag
from spool_sim.excitation.kinds import Recorded
from spool_sim.sensors import Sensor, Sensors, load_sensors
from spool_sim.simulator import Simulator
from spool_sim.valve.description import find_valve
from spool_stream.errors import InputError
from spool_stream.text.printable import printable
from spool_stream.uncertainty import LEGEND, with_interval

from spool_tools.console.outputs import STANDARD_OUTPUT, making_room, write_file, write_standard_output
from spool_tools.console.progress import progress
from spool_tools.console.terminal import cell, fail, warn
from spool_tools.input.bag_valve import VALVE_DESCRIPTION, encode_valve
from spool_tools.input.csv_blocks import CsvSource
from spool_tools.input.record_loading import is_csv, parse_columns
from spool_tools.input.recorded_excitation import find_excitation

from .replay_command import RefitRequest, replay_bag

#: 2025-01-01 UTC: a simulated record has no time of its own.
SIMULATION_START = 1_735_689_600_000_000_000
SIMULATION_SECONDS = 40.0
#: Damaged places of a bag that are listed one by one.
MOST_PLACES = 20


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
    if not 0.0 <= noise < math.inf:
        raise InputError(f"--noise {noise:g} m/s^2: use a number of at least 0")
    if seed < 0:
        raise InputError(f"--seed {seed}: use a whole number of at least 0")
    plain = Sensor(noise=noise)
    measured = Sensors(body=plain, spool=plain) if sensors is None else load_sensors(sensors)
    drive = find_excitation(excitation)
    if seconds is None:
        seconds = drive.duration if isinstance(drive, Recorded) else SIMULATION_SECONDS
    described = find_valve(valve)
    temperatures = _temperatures(oil_temperature)
    simulator = Simulator(
        described.at(temperatures[0]) if len(temperatures) == 1 else described,
        drive,
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
    print(f"{out}: {count} blocks of {valve_id} in /{name}, {seconds:g} s at {sample_rate:g} Hz")


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


def import_record(file: Path, out: Path, name: str, columns: str | None, start: str | None) -> None:
    """Turn a CSV record into a bag and say what went into it."""
    moment = None if start is None else _moment(start)
    with making_room(out):
        result = import_csv(file, out, valve=name, columns=parse_columns(columns), start=moment)
    for warning in result.warnings:
        warn(warning)
    lost = f", {result.lost_blocks} blocks lost in gaps" if result.lost_blocks else ""
    print(
        f"{out}: {result.samples} samples in {result.blocks} blocks of /{name}, "
        f"{result.duration:.1f} s at {1.0 / result.period:g} Hz{lost}"
    )


def _moment(start: str) -> int:
    """Return the time ``start`` (ISO 8601, UTC where it names no zone) in ns since 1970."""
    try:
        time = datetime.fromisoformat(start.replace("Z", "+00:00"))
        zoned = time if time.tzinfo else time.replace(tzinfo=timezone.utc)
        return round(zoned.timestamp()) * 1_000_000_000
    except (ValueError, OverflowError) as error:
        raise InputError(f"--start {start!r}: write it like 2025-01-31T12:00:00") from error


def export(bag: Path, out: Path, valves: Sequence[str] | None) -> None:
    """Write a bag's samples as a table and say how many."""
    with making_room(out), progress("exporting") as advance:
        result = export_bag(bag, out, valves=valves, progress=advance)
    for warning in result.warnings:
        warn(warning)
    print(f"{out}: {result.rows} rows of {printable(', '.join(result.valves))}")


def info(record: Path, json: Path | None, columns: str | None = None) -> int:
    """Show what is in a bag or CSV file; return 1 where something was lost or is damaged.

    2 where a bag has nothing of a valve in it.
    """
    with progress("reading"):
        found = CsvSource(record, parse_columns(columns)).describe() if is_csv(record) else describe(record)
    if json is not None:
        write_json(json, found.to_dict())
    _show(found)
    if not found.valves:
        held = ", ".join(f"{topic.name} ({topic.type})" for topic in found.topics[:5]) or "nothing"
        return fail(
            f"{record}: no valve in it: it holds {held}; what is looked for is a topic NAME/acceleration of "
            f"{ACCELERATION_BLOCK}"
        )
    broken = not found.closed or found.damages or found.undecodable
    return 1 if broken or any(valve.lost_blocks or valve.refused_blocks for valve in found.valves) else 0


def _show(found: BagInformation) -> None:
    console = Console()
    duration = "?" if found.duration is None else f"{found.duration:.1f} s"
    state = "closed properly" if found.closed else "not closed properly: see ./spool recover"
    text = f"{found.path}: {duration}, {found.size / 1e6:.1f} MB, {state}"
    console.print(cell(text), soft_wrap=True)
    topics = Table(box=None, pad_edge=False)
    for column in ("topic", "type", "messages", "per second"):
        # A name is never cut: where the terminal is too narrow it goes on in the next line.
        topics.add_column(column, overflow="fold")
    for topic in found.topics:
        rate = "" if topic.rate is None else f"{topic.rate:.1f}"
        topics.add_row(cell(topic.name), cell(topic.type), str(topic.messages), rate)
    if found.topics:
        console.print(topics)
    valves = Table("valve", "blocks", "samples", "Hz", "lost", "refused", box=None, pad_edge=False)
    for valve in found.valves:
        rate = "?" if valve.sample_rate is None else f"{valve.sample_rate:g}"
        cells = (valve.blocks, valve.samples, rate, valve.lost_blocks, valve.refused_blocks)
        valves.add_row(cell(valve.name), *map(str, cells))
    if found.valves:
        console.print(valves)
    if found.damages:
        lost = _lost(found.lost_messages, estimated=found.lost_estimated)
        text = f"{_damaged(found.damages)}, {lost} messages lost: see ./spool recover"
        console.print(cell(text), soft_wrap=True)
    for warning in found.warnings:
        warn(warning)


def _damaged(damages: Sequence[Damage]) -> str:
    """Return how many places of a bag are damaged, and how much of it."""
    places = "1 damaged place" if len(damages) == 1 else f"{len(damages)} damaged places"
    return f"{places} ({sum(damage.size for damage in damages)} bytes)"


def _lost(count: int, *, estimated: bool) -> str:
    """Return how many messages were lost, as well as it is known."""
    if estimated:
        return f"about {count}" if count else "an unknown number of"
    return str(count)


def recover_bag(bag: Path, out: Path) -> int:
    """Copy what is readable into a new bag; return 1 where something was lost."""
    with making_room(out), progress("recovering"):
        result = recover(bag, out)
    kept, bad = sum(result.messages.values()), sum(result.undecodable.values())
    lost = _lost(result.lost, estimated=result.estimated)
    print(f"{out}: {kept} messages saved, {lost} lost, {bad} not decodable, {_damaged(result.damages)}")
    for damage in result.damages[:MOST_PLACES]:
        gone = "an unknown number of" if damage.lost is None else str(damage.lost)
        place = f"at byte {damage.offset}, {damage.size} bytes: {printable(damage.reason)}"
        print(f"  {place}; {gone} messages lost")
    if len(result.damages) > MOST_PLACES:
        print(f"  and {len(result.damages) - MOST_PLACES} more")
    for valve, missing in result.missing.items():
        print(f"  /{printable(valve)}: {missing} blocks are missing by their sequence numbers")
    if not result.closed:
        print("  the recording was not finished: what was not yet on the disk at its end is not counted")
    for warning in result.warnings:
        warn(warning)
    return 1 if result.lost or bad or result.damages else 0


def replay(
    bag: Path,
    valves: Sequence[str],
    json: Path | None,
    refits: RefitRequest | None = None,
    method: str = "prediction",
    columns: str | None = None,
) -> None:
    """Run estimator and monitor over a record; show the result and write it as JSON."""
    result = replay_bag(bag, valves, refits=refits, method=method, columns=columns)
    if json is not None:
        write_json(json, result)
    console = Console()
    for warning in result["warnings"]:
        warn(warning)
    for name, valve in result["valves"].items():
        losses = f"{valve['lost_blocks']} lost" if valve["lost_blocks"] else "none lost"
        for warning in valve["warnings"]:
            warn(warning)
        text = f": {valve['blocks']} blocks, {losses}; {valve['valve']['sentence']}"
        console.print(cell(name, "bold") + cell(text), soft_wrap=True)
        state = str(valve["estimate"]["state"] or "no estimate").replace("_", " ")
        console.print(f"  at the end ({state}), {LEGEND}:", highlight=False, soft_wrap=True)
        for parameter, quantity in valve["estimate"]["parameters"].items():
            console.print(f"  {parameter.replace('_', ' '):22} {_number(quantity)}", highlight=False)
        for found in valve.get("refits", ()):
            fitted = ", ".join(
                f"{name.replace('_', ' ')} {_number(found['parameters'][name])}" for name in found["fitted"]
            )
            text = f"refit {found['state'].replace('_', ' ')}: {fitted or found['reason']}"
            console.print(cell(f"  {found['t_s']:8.1f} s  {text}"), soft_wrap=True)
        for event in valve["events"]:
            cause = f" ({event['cause'].replace('_', ' ')})" if event["cause"] else ""
            what = f"{event['kind'].replace('_', ' ')}{cause}: " if event["state"] == "raised" else ""
            text = f"{event['severity']} {event['state']}: {what}{event['message']}"
            console.print(cell(f"  {event['t_s']:8.1f} s  {text}"), soft_wrap=True)


def _number(quantity: Mapping[str, Any]) -> str:
    return with_interval(quantity["value"], quantity["std"], quantity["unit"])


def write_json(path: Path, value: object) -> None:
    """Write ``value`` as JSON with null for numbers that are not finite; ``-`` is standard output.

    Raises:
        InputError: the file can't be written, or is there already.
    """
    text = json_module.dumps(_finite(value), indent=1, allow_nan=False) + "\n"
    if path == STANDARD_OUTPUT:
        write_standard_output(text)
    else:
        write_file(path, text, "--json")


def _finite(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _finite(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(entry) for entry in value]
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    return value
