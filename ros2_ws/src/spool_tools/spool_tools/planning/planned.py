"""Planned record: simulated with the sensors, the excitation and the length that are planned."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from spool_estimator.identification.record import Record
from spool_sim.excitation.base import Excitation
from spool_sim.model import Model
from spool_sim.sensors import Sensor
from spool_sim.simulator import Simulator
from spool_sim.valve.description import FILM, Valve

Array = NDArray[np.float64]

#: Hz below which the way in the body is not taken from accelerations: their double integral drifts.
SLOWEST = 3.0


@dataclass(frozen=True, slots=True)
class Plan:
    """Plan of a record: ``seconds`` at ``sample_rate`` (Hz), sensors of ``noise`` (m/s^2 rms per sample)."""

    valve: Valve
    excitation: Excitation
    seconds: float = 40.0
    sample_rate: float = 2000.0
    noise: float = 0.05
    seed: int = 0

    def values(self, changes: Mapping[str, float]) -> dict[str, float]:
        """Return ``changes``, with the drag that fits start from where the valve's film is not known."""
        if self.valve.knows(*FILM):
            return dict(changes)
        return {"viscous_coefficient": self.valve.likely_viscous_coefficient, **changes}

    def record(self, model: Model, values: Mapping[str, float], *, noisy: bool = True) -> Record:
        """Return what the planned sensors would say of a valve with ``model`` and ``values``.

        Raises:
            InputError: excitation and sample rate do not fit, or a value is out of range.
        """
        sensor = Sensor(noise=self.noise if noisy else 0.0)
        simulator = Simulator(
            self.valve,
            self.excitation,
            model=model,
            parameters=self.values(values),
            sample_rate=self.sample_rate,
            seed=self.seed,
            body_sensor=sensor,
            spool_sensor=sensor,
        )
        blocks = list(simulator.records(self.seconds))
        body, spool = (
            np.concatenate([getattr(block, channel) for block in blocks]).astype(np.float64)
            for channel in ("body", "spool")
        )
        return Record("planned", blocks[0].stamp, blocks[0].sample_period, body, spool)


def travel(record: Record) -> float:
    """Return the largest way of the spool from its centre, m: the double integral from ``SLOWEST`` Hz on."""
    relative = record.spool - record.body
    frequency = np.fft.rfftfreq(relative.size, record.sample_period)
    spectrum = np.fft.rfft(relative)
    passed = frequency >= SLOWEST
    way = np.zeros_like(spectrum)
    way[passed] = -spectrum[passed] / (2.0 * np.pi * frequency[passed]) ** 2
    return float(np.max(np.abs(np.fft.irfft(way, relative.size))))
