"""Records as the commands load them: samples by valve, and which valve file describes them."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from spool_bag import BODY, OIL_TEMPERATURE, SPEED, SPOOL
from spool_bag.blocks import Span
from spool_bag.importing.bag_import import import_notes, start_of, stream_of
from spool_bag.importing.choices import Choices, columns_of
from spool_bag.importing.logger_record import LoggerRecord
from spool_bag.metadata import rate_std
from spool_bag.reader import BagReader
from spool_core.block import Block
from spool_core.cdr import OilTemperature, Reading, Speed
from spool_core.errors import InputError
from spool_core.record_limits import LIMITS
from spool_core.text import did_you_mean, plural
from spool_estimator.identification.channel_faults import ChannelFault, faults_of, without_outliers
from spool_estimator.identification.record import PartKeeper, Record, records_from_blocks, without_strokes
from spool_estimator.plausibility import check_records
from spool_estimator.record_judgement import changing, check_rate, check_samples, doubts_of
from spool_report.records import record_sources
from spool_report.records.record_sources import TableSource, is_table, split_name
from spool_report.requests import Selection
from spool_sim.valve import Valve, find_valve, shipped_valves

#: What a replay reads.
Source = BagReader | TableSource


#: Stretches of a record that are looked at for faults of its channels.
MOST_STRETCHES = 8

DEFAULT_VALVE = "4weh10_soft"

#: s of the pieces that are held out, at least, and one piece of how many is.
PIECE, EVERY = 2.5, 4
#: Pieces a record is divided into at most.
PIECES = 8

#: Causes without which no number of a fit means anything.
REFUSED = ("same_channel", "wrap_around", "repeats", "sensitivity", "clock_step", "clock_drift")


@dataclass(frozen=True, slots=True)
class Recording:
    """One bag or logger's file of one valve.

    Attributes:
        path: where it is.
        stretches: without gaps each, in order of time.
        described: the valve's description in the bag, ``None`` without one.
        notes: how the file was understood, or that of which the bag was imported: columns and conversions.
        left_out: single impossible samples of either channel, which lines between their neighbours replace.
        speeds: stamps (ns) and rev/min of the machine's shaft, as recorded.
        strokes: of a solenoid, which are left out of the stretches where the valve is known.
    """

    path: Path
    stretches: tuple[Record, ...]
    described: Valve | None
    notes: tuple[str, ...] = ()
    left_out: int = 0
    speeds: tuple[tuple[int, float], ...] = ()
    strokes: int = 0

    @property
    def duration(self) -> float:
        """Of all stretches together, s."""
        return sum(stretch.duration for stretch in self.stretches)


def open_source(path: Path, columns: str | None = None, span: Span | None = None) -> Source:
    """Return the record at ``path``, a bag or a logger's file with ``columns`` as of ``--columns``.

    Raises:
        InputError: there is none, or it cannot be read.
    """
    if is_table(path):
        return TableSource(path, columns_of(columns))
    if columns is not None:
        raise InputError(f"--columns: {path} is a bag: leave it out")
    return BagReader(path, span=span or Span())


def valve_in(reader: Source, name: str | None) -> str:
    """Return the valve ``name`` of a record, or its only one.

    Raises:
        InputError: it has no such valve, or several and ``name`` is ``None``.
    """
    known = reader.valves
    if not known:
        raise InputError(f"{reader.path}: no acceleration topic in it")
    if name is not None:
        if name.strip("/") not in known:
            raise InputError(f"{reader.path}: no valve {name!r}: the bag has {', '.join(known)}")
        return name.strip("/")
    if len(known) > 1:
        raise InputError(f"{reader.path}: it holds {', '.join(known)}: choose one with --name")
    return known[0]


def load_recording(path: Path, selection: Selection | None = None) -> Recording:
    """Return what ``path`` (rosbag2 directory, .mcap, any file that `import` reads) holds of one valve.

    Raises:
        InputError: unreadable, no such valve, several and none named, or no samples in the chosen time.
    """
    chosen = selection or Selection()
    described = None
    oil: list[tuple[int, float]] = []
    speeds: list[tuple[int, float]] = []
    if is_table(path):
        table = record_sources.record_of_table(path, columns=chosen.columns, how=chosen.how)
        stretches, notes = stretches_of_table(table, str(path)), table.notes
        items = stream_of(table, start_of(table)) if SPEED in table.columns else ()
        speeds = [(one.stamp, one.rpm) for one in items if isinstance(one, Speed)]
    else:
        if chosen.how not in (None, Choices()):
            raise InputError(
                f"{path}: a bag states its units and rate: leave --unit, --scale, --rate and --exclude out"
            )
        notes = import_notes(path)
        reader = BagReader(path, span=record_sources.span_of(path, chosen.when))
        name = valve_in(reader, chosen.name)
        blocks = _blocks_beside(reader.stream(name), oil, speeds)
        if chosen.longest is None:
            stretches = records_from_blocks(blocks, str(path), oil)
        else:
            keeper = PartKeeper(chosen.longest)
            for block in _blocks_between(blocks, chosen.start, chosen.stop):
                keeper.take(block)
            stretches = keeper.records(str(path), oil)
        stretches = [replace(one, rate_std=rate_std(path)) for one in stretches]
        described = record_sources.recorded_valve(reader, name) if chosen.described else None
    if not stretches:
        raise InputError(f"{path}: no sample in it that can be used")
    # What lies between start and stop, s since the first sample.
    kept = []
    for stretch in stretches:
        begins = (stretch.start - stretches[0].start) * 1e-9
        first = max(0, math.ceil((chosen.start - begins) / stretch.sample_period - 1e-6))
        end = (chosen.stop - begins) / stretch.sample_period
        until = stretch.body.size if end >= stretch.body.size else math.ceil(end - 1e-6)
        if first < until:
            whole = first == 0 and until == stretch.body.size
            kept.append(stretch if whole else stretch.part(first, until))
    if not kept:
        last = stretches[-1]
        ends = (last.start - stretches[0].start) * 1e-9 + last.duration
        raise InputError(f"{path}: no sample from --start {chosen.start:g} s on: it is {ends:.1f} s long")
    cleaned, left_out = cleaned_stretches(kept)
    return Recording(path, cleaned, described, notes, left_out, tuple(speeds))


def cleaned_stretches(stretches: Sequence[Record]) -> tuple[tuple[Record, ...], int]:
    """Return ``stretches`` without single impossible samples, and how many samples that were."""
    cleaned, count = [], 0
    for one in stretches:
        body, of_body = without_outliers(one.body, one.sample_period)
        spool, of_spool = without_outliers(one.spool, one.sample_period)
        count += of_body + of_spool
        cleaned.append(replace(one, body=body, spool=spool) if of_body + of_spool else one)
    return tuple(cleaned), count


def outliers_text(count: int) -> str:
    """Return in words that ``count`` single impossible samples were left out."""
    return (
        f"outliers: {count} impossible sample{'s are' if count > 1 else ' is'} left out and replaced by "
        "lines between the neighbours: check plugs, cables and what the logger writes where it has no reading"
    )


def channel_faults(stretches: Sequence[Record]) -> list[ChannelFault]:
    """Return what the samples of the longest stretches show of sensors and clocks, each cause once."""
    longest = sorted(_changing(stretches), key=lambda one: -one.body.size)[:MOST_STRETCHES]
    found: dict[str, ChannelFault] = {}
    for one in longest:
        for fault in faults_of(one.body, one.spool, one.sample_period):
            found.setdefault(fault.cause, fault)
    return list(found.values())


def load_recordings(
    paths: Sequence[Path], valve: str | Valve | None, selection: Selection | None = None
) -> tuple[list[Recording], Valve]:
    """Return the records and the valve that all of them are of.

    Args:
        paths: bags and loggers' files, in any mixture.
        valve: a description, a valve file, a shipped valve's name, or the namespace of a valve that the bags
            describe; ``None`` takes the bags' description.
        selection: what to take of each.

    Raises:
        InputError: as ``load_recording``; no description of the valve, or bags that describe different ones.
    """
    chosen = selection or Selection()
    given = None
    if isinstance(valve, Valve):
        given, chosen = valve, replace(chosen, described=False)
    elif valve is not None:
        given, name = _valve_or_name(valve, paths, chosen.name)
        chosen = replace(chosen, name=name, described=given is None)
    recordings = [load_recording(path, chosen) for path in paths]
    if given is not None:
        return [switched(one, given) for one in recordings], given
    described = {
        recording.described: recording.path for recording in recordings if recording.described is not None
    }
    if not described:
        raise InputError(
            f"{paths[0]}: it does not describe its valve: name a valve file with --valve, or one of "
            f"{', '.join(shipped_valves())}"
        )
    if len(described) > 1:
        first, second = list(described.values())[:2]
        raise InputError(f"{first} and {second} describe different valves: choose one with --valve")
    found = next(iter(described))
    return [switched(one, found) for one in recordings], found


def switched(recording: Recording, valve: Valve) -> Recording:
    """Return ``recording`` of ``valve`` without its strokes."""
    parts = [without_strokes(one, valve.natural_frequency) for one in recording.stretches]
    count = sum(strokes for _, strokes in parts)
    return replace(recording, stretches=tuple(one for some, _ in parts for one in some), strokes=count)


def stretches_of(recordings: Sequence[Recording]) -> list[Record]:
    """Return the stretches of all ``recordings``."""
    return [stretch for recording in recordings for stretch in recording.stretches]


def stretches_of_table(record: LoggerRecord, name: str | None = None) -> list[Record]:
    """Return the stretches without gaps of a logger's record."""
    oil = record.columns.get(OIL_TEMPERATURE)
    if oil is not None:  # empty cells are filled along straight lines
        known = np.isfinite(oil)
        oil = np.interp(record.time, record.time[known], oil[known]) if known.any() else None
    start = start_of(record)
    origin = start + round(float(record.time[0]) * 1e9)
    return [
        Record(
            name or str(record.path),
            start + round(float(record.time[begin]) * 1e9),
            record.period,
            record.columns[BODY][begin:end],
            record.columns[SPOOL][begin:end],
            None if oil is None else oil[begin:end],
            origin,
            rate_std=record.rate_std,
        )
        for begin, end in pairwise([0, *record.gaps.tolist(), record.time.size])
    ]


@dataclass(frozen=True, slots=True)
class ChosenValve:
    """Valve description that was chosen.

    Attributes:
        valve: the description.
        source: ``given`` on the command line, ``recorded`` in the bag, or ``assumed``.
        file: what was given or assumed, empty where it was recorded.
    """

    valve: Valve
    source: str
    file: str = ""

    def sentence(self) -> str:
        """Return which valve it is and why, for people."""
        why = {
            "given": f"from --valve {self.file}",
            "recorded": "from the bag",
            "assumed": f"ASSUMED to be {self.file}",
        }[self.source]
        return f"valve {self.valve.id} ({self.valve.natural_frequency:.3g} Hz), {why}"

    def warning(self, name: str) -> str:
        """Return what to do about an assumption, empty where none was made."""
        if self.source != "assumed":
            return ""
        return (
            f"{name}: the record does not describe its valve and --valve is not given: {self.file} "
            f"({self.valve.moving_mass:g} kg, {self.valve.natural_frequency:.3g} Hz) is assumed; stiffness, "
            "damping and friction scale with its moving_mass: give --valve FILE"
        )


def choose_valves(source: Source, names: Sequence[str], given: Sequence[str]) -> dict[str, ChosenValve]:
    """Return the description of each valve of ``source``.

    Args:
        source: the record.
        names: of its valves.
        given: ``FILE`` once for all or once for each in order of name, or ``NAME=FILE`` for some or all.

    Raises:
        InputError: no such file or valve, one given twice, or a number that fits neither one nor each.
    """
    pairs = [split_name(text) for text in given]
    named = {name: file for name, file in pairs if name}
    unnamed = [file for name, file in pairs if not name]
    if named and unnamed:
        raise InputError(f"--valve {unnamed[0]}: others have a name: write NAME={unnamed[0]} as well")
    for name, file in named.items():
        if name not in names:
            raise InputError(
                f"--valve {name}={file}: {source.path} has no valve {name}: it has {', '.join(names)}"
                f"{did_you_mean(name, names)}"
            )
        if sum(name == other for other, _ in pairs) > 1:
            raise InputError(f"--valve {name}=...: given twice: give it once")
    if len(unnamed) == 1:
        unnamed = unnamed * len(names)
    elif unnamed and len(unnamed) != len(names):
        raise InputError(
            f"--valve was given {len(unnamed)} times, the bag holds {', '.join(names)}: "
            "give it once for all, or NAME=FILE for each"
        )
    files = named or dict(zip(names, unnamed, strict=False))
    return {
        name: ChosenValve(find_valve(files[name]), "given", files[name])
        if name in files
        else _without_file(source, name)
        for name in names
    }


@dataclass(frozen=True, slots=True)
class FitData:
    """Records of one valve.

    Attributes:
        name: of the whole, for tables.
        paths: what was read.
        valve: what all of it is of.
        fitted: stretches that parameters come from.
        held_out: stretches that errors are validated by, empty where the records are too short for that.
        held_paths: records that were named to be held out; empty where pieces of the others are.
        doubts: what speaks against the valve's description, a sentence each.
    """

    name: str
    paths: tuple[Path, ...]
    valve: Valve
    fitted: tuple[Record, ...]
    held_out: tuple[Record, ...]
    held_paths: tuple[Path, ...] = ()
    doubts: tuple[str, ...] = ()

    @property
    def seconds(self) -> float:
        """Length of the data that are fitted, s."""
        return sum(entry.duration for entry in self.fitted)


def load_data(
    paths: Sequence[Path],
    valve: str | Valve | None,
    selection: Selection,
    held_out: Sequence[Path] = (),
    *,
    springs: bool = True,
) -> FitData:
    """Return the records ``paths`` as one set of data of one valve.

    Args:
        paths: bags and CSV files.
        valve: as in ``load_recordings``.
        selection: what to take of each of ``paths``; of records held out all is taken.
        held_out: records to judge errors by; without any, pieces of ``paths`` are held out.
        springs: doubt the description where the records show another natural frequency.

    Raises:
        InputError: unreadable, too short, or nothing moves in them.
    """
    recordings, described = load_recordings(paths, valve, selection)
    for recording in recordings:
        check(recording)
        for stretch in recording.stretches:
            check_rate(str(recording.path), stretch.sample_rate, described)
    records = stretches_of(recordings)
    name = ", ".join(path.name for path in paths)
    doubts = (
        *channel_doubts(recordings),
        *doubts_of(records, described),
        *(check_records(described, records) if springs else ()),
    )
    records = _changing(records) or records
    if not held_out:
        return FitData(name, tuple(paths), described, *divided(records), doubts=doubts)
    others: list[Record] = []
    for path in held_out:
        recording = switched(load_recording(path, Selection(selection.name, selection.columns)), described)
        check(recording)
        others += _changing(recording.stretches)
    return FitData(name, tuple(paths), described, tuple(records), tuple(others), tuple(held_out), doubts)


def check(recording: Recording) -> None:
    """Refuse what nothing can be learnt from; see ``check_samples``."""
    check_samples(str(recording.path), recording.stretches)


def channel_doubts(recordings: Sequence[Recording]) -> tuple[str, ...]:
    """Return what the samples show of sensors and clocks that a fit can bear, a sentence each.

    Raises:
        InputError: no fit can bear it; record, cause and remedy are named.
    """
    doubts = []
    for recording in recordings:
        name = recording.path.name
        if recording.left_out:
            doubts.append(f"{name}: {outliers_text(recording.left_out)}")
        if recording.strokes:
            switches = plural(recording.strokes, "stroke")
            doubts.append(f"{name}: the valve was switched: {switches} and the time at a stop are left out")
        for fault in channel_faults(recording.stretches):
            if fault.cause in REFUSED:
                raise InputError(f"{recording.path}: {fault.sentence}")
            doubts.append(f"{name}: {fault.sentence}")
    return tuple(doubts)


def divided(records: Sequence[Record]) -> tuple[tuple[Record, ...], tuple[Record, ...]]:
    """Return what is fitted and what is held out of ``records``: one piece in ``EVERY``, spread over each.

    A sweep passes every frequency once, so pieces are spread instead of cut off at an end. Where no record is
    long enough for that nothing is held out.
    """
    fitted: list[Record] = []
    held: list[Record] = []
    for entry in records:
        count = min(PIECES, int(entry.duration / PIECE))
        if count < EVERY:
            fitted.append(entry)
            continue
        edges = [entry.body.size * number // count for number in range(count + 1)]
        begin = 0
        for number in range(EVERY // 2, count, EVERY):
            fitted.append(entry.part(edges[begin], edges[number]))
            held.append(entry.part(edges[number], edges[number + 1]))
            begin = number + 1
        if begin < count:
            fitted.append(entry.part(edges[begin], entry.body.size))
    return tuple(fitted), tuple(held)


def _changing(stretches: Iterable[Record]) -> list[Record]:
    return [part for one in stretches for part in changing(one, LIMITS.seconds_of_estimate)]


def _blocks_beside(
    stream: Iterable[Block | Reading], oil: list[tuple[int, float]], speeds: list[tuple[int, float]]
) -> Iterator[Block]:
    """Yield the blocks of a stream; its slow readings are appended to ``oil`` and ``speeds``."""
    for item in stream:
        if isinstance(item, Block):
            yield item
        elif isinstance(item, Speed):
            speeds.append((item.stamp, item.rpm))
        elif isinstance(item, OilTemperature):
            oil.append((item.stamp, item.celsius))


def _blocks_between(blocks: Iterable[Block], start: float, stop: float) -> Iterator[Block]:
    """Yield the first block, from which time counts, and those from ``start`` to ``stop`` s after it."""
    first: int | None = None
    for block in blocks:
        first = block.stamp if first is None else first
        inside = (block.end - first) * 1e-9 >= start and (block.stamp - first) * 1e-9 < stop
        if inside or block.stamp == first:
            yield block


def _valve_or_name(valve: str, paths: Sequence[Path], name: str | None) -> tuple[Valve | None, str | None]:
    """Return the valve that ``valve`` describes, or the namespace that it is in a bag.

    ``NAME=FILE`` gives both.
    """
    own, file = split_name(valve)
    if own:
        if name is not None and name.strip("/") != own:
            raise InputError(f"--valve {valve}: --name is {name}: leave one of them out")
        return find_valve(file), own
    if valve not in shipped_valves() and not Path(valve).exists() and name is None:
        held = {entry for path in paths if not is_table(path) for entry in BagReader(path).valves}
        if valve.strip("/") in held:
            return None, valve
    return find_valve(valve), name


def _without_file(source: Source, name: str) -> ChosenValve:
    recorded = None if isinstance(source, TableSource) else record_sources.recorded_valve(source, name)
    if recorded is not None:
        return ChosenValve(recorded, "recorded")
    return ChosenValve(find_valve(DEFAULT_VALVE), "assumed", DEFAULT_VALVE)
