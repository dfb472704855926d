"""Excitation from a record: the body acceleration of a bag or a logger's file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError
from spool_bag.format.metadata import is_bag_file
from spool_bag.reading.reader import BagReader
from spool_core.block_gate import BlockGate, Verdict
from spool_core.errors import InputError
from spool_sim.excitation.kinds import Excitation, Recorded, load_excitation
from spool_sim.excitation.presets import PRESETS
from spool_sim.files.validation import one_line, read_mapping

from .table_record import is_table, record_of_table

Array = NDArray[np.float64]


class _RecordFile(BaseModel):
    """File of kind ``recorded``: its ``file`` lies next to it, or anywhere by its full path."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    kind: Literal["recorded"]
    file: Path
    valve: str | None = None
    soft_start: Annotated[float, Field(ge=0.0, le=1e6)] = 0.0


def find_excitation(name: str) -> Excitation:
    """Return the excitation ``name``: a preset, a YAML file of any kind, a bag or a logger's file.

    Raises:
        InputError: nothing of that name, or what is there cannot be used; file and place are named.
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
    samples, period = _from_table(path) if is_table(path) else _from_bag(path, valve)
    if samples.size < 2:
        raise InputError(f"{path}: {samples.size} samples are too few for an excitation")
    return Recorded(samples=samples, sample_rate=1.0 / period, source=str(path), soft_start=soft_start)


def _from_table(path: Path) -> tuple[Array, float]:
    record = record_of_table(path)
    if record.gaps.size:
        raise InputError(
            f"{path}: samples are missing before {record.time[record.gaps[0]]:g} s; cut the record there"
        )
    return record.columns["body_m_s2"], record.period


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
