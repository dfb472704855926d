"""Segments of the records: which are fitted and which are held out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from spool_core.errors import InputError
from spool_estimator.identification.free_run import FreeRun, Window, excitation_limit
from spool_estimator.identification.record import Record
from spool_estimator.identification.spectra import (
    ChannelNoise,
    Quiet,
    RelativeMotion,
    ZeroPhase,
    delayed,
    noise_of,
    quiet,
    relative_motion,
)
from spool_sim.model import Model
from spool_sim.valve import Valve

Array = NDArray[np.float64]

#: s that count in one window.
WINDOW = 0.6
#: Samples of a record that are conditioned in one piece; longer records are represented by parts.
LONGEST_PIECE = 400_000
#: Time constants of the motion after which its start is forgotten.
FORGOTTEN = 6.0
#: Hz, no excitation of a valve is looked for below.
LOWEST = 1.0


@dataclass(frozen=True, slots=True)
class Stretch:
    """One record with what was found out about it before any model.

    Attributes:
        record: as measured.
        noise: of both channels, with the excitation's band.
        low_cut: Hz, where the conditioning begins to let pass.
        motion: relative motion with the gain and delay that were assumed.
        kept: 0 where a sample says nothing because a channel clips, else 1, shape (n,).
        windows: that are simulated.
        training: for each window, whether it is fitted.
        highest_frequency: of the excitation, Hz.
        quiet: what took the body's noise off the excitation.
    """

    record: Record
    noise: ChannelNoise
    low_cut: float
    motion: RelativeMotion
    kept: Array
    windows: tuple[Window, ...]
    training: tuple[bool, ...]
    highest_frequency: float
    quiet: Quiet


def corrected(record: Record, gain: float, delay: float) -> Record:
    """Return ``record`` with the spool's channel freed of a relative gain error and a delay (s)."""
    if gain == 0.0 and delay == 0.0:
        return record
    spool = delayed(record.spool, -delay, record.sample_period) / (1.0 + gain)
    return replace(record, spool=spool)


def parts_of(records: Sequence[Record], longest: int) -> list[Record]:
    """Return parts of long records that together hold at most ``longest`` samples, spread over the time.

    Parts with more motion are preferred within each piece of the time.
    """
    total = sum(record.body.size for record in records)
    if total <= longest:
        return list(records)
    found = []
    for record in records:
        budget = max(1, int(longest * record.body.size / total))
        length = max(round(12.0 / record.sample_period), 4096)
        count = max(1, budget // length)
        if record.body.size <= 2 * length:
            found.append(record)
            continue
        for number in range(count):
            begin = record.body.size * number // count
            end = record.body.size * (number + 1) // count
            starts = np.arange(begin, max(begin + 1, end - length), max(1, length // 2))
            level = [float(record.body[start : start + length].std()) for start in starts.tolist()]
            first = int(starts[int(np.argmax(level))])
            found.append(record.part(first, min(first + length, record.body.size)))
    return found


def stretches_of(
    records: Sequence[Record],
    held_out: Sequence[Record],
    model: Model,
    valve: Valve,
    *,
    damping: float,
    gain: float = 0.0,
    delay: float = 0.0,
    clipped: Sequence[Array] | None = None,
) -> list[Stretch]:
    """Return the stretches of ``records`` and ``held_out`` with their windows.

    Without ``held_out`` every other window is held out.

    Raises:
        InputError: the records are too short for one window to fit and one to hold out.
    """
    found: list[Stretch] = []
    everything = [(record, True) for record in records] + [(record, False) for record in held_out]
    run_in = float(np.clip(FORGOTTEN * 2.0 * valve.moving_mass / max(damping, 1e-3), 0.5, 2.0))
    for number, (record, trains) in enumerate(everything):
        noise = noise_of(record.body, record.spool, record.sample_rate)
        low_cut = max(LOWEST, 0.4 * noise.low)
        window = min(WINDOW, max(0.5, 0.25 * (record.duration - run_in - 2.0 / low_cut)))
        better = corrected(record, gain, delay)
        silence = quiet(record.body, noise.body, record.sample_rate)
        try:
            run = FreeRun(
                [replace(better, body=silence.apply(record.body))],
                model,
                valve,
                window=window,
                run_in=run_in,
                low_cut=low_cut,
            )
        except InputError:
            continue
        means = ZeroPhase(record.sample_period, 0.0).apply(record.spool, interval_means=True)
        windows = [
            replace(
                entry,
                measured=record.spool[entry.start : entry.stop],
                measured_means=means[entry.start : entry.stop],
                record=number,
            )
            for entry in run.windows
        ]
        if held_out:
            training = [trains] * len(windows)
        else:
            offset = sum(len(entry.windows) for entry in found)
            training = [(offset + place) % 2 == 0 for place in range(len(windows))]
        motion = relative_motion(better.body, better.spool, ZeroPhase(record.sample_period, low_cut))
        kept = np.ones(record.body.size) if clipped is None else clipped[number]
        found.append(
            Stretch(
                record,
                noise,
                low_cut,
                motion,
                kept,
                tuple(windows),
                tuple(training),
                min(run.highest_frequency[0], excitation_limit(record)),
                silence,
            )
        )
    trained = sum(sum(entry.training) for entry in found)
    if trained == 0 or trained == sum(len(entry.windows) for entry in found):
        longest_one = max((record.duration for record, _ in everything), default=0.0)
        raise InputError(
            f"{records[0].name}: too short: its longest stretch has {longest_one:.2f} s; an analysis "
            f"needs about {run_in + 2.0 + 2.0 / LOWEST:.0f} s, a part to fit and a part to hold out"
        )
    return found


def thinned(stretches: Sequence[Stretch], longest: int) -> list[Stretch]:
    """Return ``stretches`` with at most ``longest`` samples to fit and as many held out.

    Half of them are spread evenly; half are those with the largest travel, where stops are reached.
    """
    result = list(stretches)
    for trains in (True, False):
        places = [
            (number, place)
            for number, stretch in enumerate(result)
            for place, training in enumerate(stretch.training)
            if training == trains
        ]
        size = [result[n].windows[p].stop - result[n].windows[p].first for n, p in places]
        if sum(size) <= longest:
            continue
        count = max(2, int(len(places) * longest / sum(size)))
        even = (count + 1) // 2
        chosen = {places[(2 * k + 1) * len(places) // (2 * even)] for k in range(even)}
        by_travel = sorted(places, key=lambda place: -_travel(result[place[0]], place[1]))
        chosen |= set([place for place in by_travel if place not in chosen][: count - len(chosen)])
        dropped = set(places) - chosen
        result = [
            replace(
                stretch,
                windows=tuple(w for p, w in enumerate(stretch.windows) if (n, p) not in dropped),
                training=tuple(t for p, t in enumerate(stretch.training) if (n, p) not in dropped),
            )
            for n, stretch in enumerate(result)
        ]
    return result


def _travel(stretch: Stretch, place: int) -> float:
    window = stretch.windows[place]
    return float(np.abs(stretch.motion.displacement[window.start : window.stop]).max())


def span_of(stretches: Sequence[Stretch]) -> float:
    """Return the time from the beginning of the first to the end of the last of ``stretches``, s."""
    begins = [stretch.record.first_sample * stretch.record.sample_period for stretch in stretches]
    ends = [begin + stretch.record.duration for begin, stretch in zip(begins, stretches, strict=True)]
    return max(ends) - min(begins)
