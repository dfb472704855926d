"""Simulator of two accelerometers on a valve: blocks of samples, as a measuring system would send them."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray
from spool_core.block import Block, Samples
from spool_core.errors import InputError
from spool_core.numbers import Array

from spool_sim.excitation import Excitation
from spool_sim.integration import composed_motion
from spool_sim.lubrication import OilTable
from spool_sim.model import Model, load_model
from spool_sim.observation import INSTANTS, Stream
from spool_sim.sensors import Sensor, SensorChannel
from spool_sim.strokes import Strokes
from spool_sim.valve import Valve

#: Parameters that may drift, and the oil's temperature, on which the viscous coefficient depends.
DRIFTING: tuple[str, ...] = ("viscous_coefficient", "coulomb_force", "spring_stiffness", "oil_temperature")
# 2020-01-01T00:00:00Z: a stamp of 0 means "no time" in ROS.
DEFAULT_START_STAMP = 1_577_836_800_000_000_000
#: deg C, told of an oil whose description names no temperature; nothing follows from it.
ROOM = 20.0
_INNER_SAMPLES = 4096
# Samples at the start over which the step size is checked by halving, 1 s of them at most.
_TRIAL_SAMPLES = 4000
#: Samples that are filtered in one piece, and steps in a sample then, at least.
_PIECE, _FILTER_STEPS = 64, 4


@dataclass(frozen=True, slots=True)
class Truth:
    """True parameters at one instant (kg, N/m, N s/m, N, deg C); ``time`` in s since the start."""

    time: float
    mass: float
    spring_stiffness: float
    viscous_coefficient: float
    coulomb_force: float
    oil_temperature: float

    @property
    def natural_frequency(self) -> float:
        """Undamped natural frequency, Hz."""
        return math.sqrt(self.spring_stiffness / self.mass) / (2.0 * math.pi)

    @property
    def damping_ratio(self) -> float:
        """Share of critical damping, from viscous drag alone."""
        return self.viscous_coefficient / (2.0 * math.sqrt(self.spring_stiffness * self.mass))


@dataclass(frozen=True, slots=True)
class _Ramp:
    """A value that runs linearly from ``start`` to ``target`` from sample ``first`` on."""

    start: float
    target: float
    first: int
    samples: int

    def at(self, samples: NDArray[np.int64]) -> NDArray[np.float64]:
        if self.samples == 0:
            return np.where(samples >= self.first, self.target, self.start)
        share = np.clip((samples - self.first) / self.samples, 0.0, 1.0)
        # Written so that share 1 gives the target exactly.
        return self.start * (1.0 - share) + self.target * share


def _check_times(sample_rate: float, block_size: int, start_stamp: int, highest: float) -> None:
    """Raise InputError where a time is out of range, or no sample rate for ``highest`` (Hz)."""
    if not (math.isfinite(sample_rate) and 1.0 <= sample_rate <= 1e6):
        raise InputError(f"sample_rate: {sample_rate:g} Hz is out of range, use 1 to 1e6 Hz")
    if not 1 <= block_size <= 1_000_000:
        raise InputError(f"block_size: {block_size} is out of range, use 1 to 1000000 samples")
    if start_stamp <= 0:
        raise InputError(f"start_stamp: {start_stamp} ns must be > 0")
    if highest >= 0.5 * sample_rate:
        raise InputError(
            f"sample_rate: {sample_rate:g} Hz cannot hold an excitation of up to {highest:g} Hz, "
            "use more than twice that"
        )


class Simulator:
    """Source of the blocks of one simulated valve.

    Blocks depend on the arguments alone: same arguments, same numbers, however they are fetched.
    """

    def __init__(
        self,
        valve: Valve,
        excitation: Excitation,
        *,
        model: Model | str = "coulomb",
        parameters: Mapping[str, float] | None = None,
        coulomb_force: float | None = None,
        sample_rate: float = 2000.0,
        block_size: int = 40,
        seed: int = 0,
        start_stamp: int = DEFAULT_START_STAMP,
        body_sensor: Sensor | None = None,
        spool_sensor: Sensor | None = None,
        strokes: Strokes | None = None,
    ) -> None:
        """Set up the valve at rest.

        Args:
            valve: gives mass, stiffness and viscous coefficient.
            excitation: acceleration of the body.
            model: a :class:`Model`, its name, or the path of its YAML file.
            parameters: values that replace those of model and valve, by name.
            coulomb_force: N, short for that entry of ``parameters``.
            sample_rate: Hz.
            block_size: samples per block.
            seed: of the sensor noise.
            start_stamp: time of the first sample, ns, > 0.
            body_sensor, spool_sensor: errors of the accelerometers, none by default. A filter reads ahead,
                so the motion runs some hundred samples ahead of the readings: a drift begins as much later.
            strokes: of the solenoid, none by default; they add its force and the stops to ``model``.

        Raises:
            InputError: a value is out of range, or the excitation does not fit the sample rate.
        """
        _check_times(sample_rate, block_size, start_stamp, excitation.highest_frequency)
        self.valve = valve
        self.excitation = excitation
        self.model = load_model(model) if isinstance(model, str) else model
        self.strokes = strokes
        if strokes is not None:
            self.model = strokes.acting_on(self.model)
        self.sample_rate = float(sample_rate)
        self.block_size = block_size
        overrides = dict(parameters or {})
        known = {parameter.name for parameter in self.model.parameters}
        if coulomb_force is not None and (coulomb_force != 0.0 or "coulomb_force" in known):
            overrides["coulomb_force"] = coulomb_force
        values = self.model.true_values_for(valve, overrides)
        self._mass = values["mass"]
        self._temperature = valve.oil_temperature if valve.knows("oil_temperature") else ROOM
        starts = {**values, "oil_temperature": self._temperature}
        self._ramps = {name: _Ramp(starts.get(name, 0.0), starts.get(name, 0.0), 0, 0) for name in DRIFTING}
        self._oil = OilTable(valve)
        self._rate = Fraction(self.sample_rate)
        self._start_stamp = start_stamp
        self._state = composed_motion.MotionState()
        self._sample = self._moved = 0
        body_seed, spool_seed = np.random.SeedSequence(seed).spawn(2)
        self._body_channel = SensorChannel(body_sensor or Sensor(), body_seed)
        self._spool_channel = SensorChannel(spool_sensor or Sensor(), spool_seed)
        self._values = values
        self._motion = composed_motion.ComposedMotion(self.model.terms)
        self._motion.warm_up()
        self._substeps, _ = composed_motion.checked_substeps(
            self._motion, values, excitation.acceleration, highest_frequency=excitation.highest_frequency,
            sample_rate=self.sample_rate, seconds=min(1.0, _TRIAL_SAMPLES / self.sample_rate),
        )  # fmt: skip
        sensors = self._body_channel.sensor, self._spool_channel.sensor
        self._streams: tuple[Stream, ...] = ()
        if any(one.filter.kind != INSTANTS for one in sensors):
            self._substeps = max(self._substeps, _FILTER_STEPS)
            self._streams = tuple(Stream(one.filter, self._substeps, one.filter_delay) for one in sensors)
        self._every = self._substeps
        self._ready: Array = np.empty((2, 0))

    @property
    def sample_period(self) -> float:
        """Seconds between samples."""
        return 1.0 / self.sample_rate

    @property
    def substeps(self) -> int:
        """Steps per sample, chosen from the stiffest rate of model and excitation and checked by halving."""
        return self._substeps

    @property
    def time(self) -> float:
        """Time of the next sample, s since the start."""
        return self._sample / self.sample_rate

    @property
    def stamp(self) -> int:
        """Acquisition time of the next sample, ns."""
        return self._start_stamp + round(self._sample * 1_000_000_000 / self._rate)

    @property
    def command(self) -> float:
        """The solenoid's command at the next sample: 1 for position a, -1 for b, 0 for the centre."""
        return 0.0 if self.strokes is None else float(self.strokes.command(np.array(self.time)))

    @property
    def truth(self) -> Truth:
        """The parameters that hold at the next sample."""
        values = self._drifted()
        if self._warms:
            values["viscous_coefficient"] *= float(self._oil.ratio(np.array(values["oil_temperature"])))
        return Truth(time=self.time, mass=self._mass, **values)

    def _drifted(self) -> dict[str, float]:
        """Return the values at the next sample, the viscous coefficient at the reference temperature."""
        now = np.array([self._sample])
        return {name: float(ramp.at(now)[0]) for name, ramp in self._ramps.items()}

    @property
    def _warms(self) -> bool:
        ramp = self._ramps["oil_temperature"]
        return ramp.start != ramp.target or ramp.target != self._temperature

    def set_drift(self, quantity: str, target: float, duration: float = 0.0) -> None:
        """Change a parameter linearly from its present value to ``target``, from the next sample on.

        Args:
            quantity: one of ``DRIFTING``.
            target: N s/m, N, N/m or deg C; the viscous coefficient at the valve's reference temperature.
            duration: s; 0 is a step.

        Raises:
            InputError: unknown quantity, not in the model, or a value out of range.
        """
        if quantity not in DRIFTING:
            raise InputError(f"drift: quantity '{quantity}' is unknown, use one of {', '.join(DRIFTING)}")
        if quantity == "oil_temperature":
            self.model.parameter("viscous_coefficient", "drift")
            self.valve.dynamic_viscosity_at(target)
        else:
            self.model.parameter(quantity, "drift").check(target, "drift")
        if not 0.0 <= duration <= 1e9:
            raise InputError(f"drift: duration {duration:g} s is out of range, use 0 to 1e9 s")
        now = self._drifted()
        ends = {name: ramp.target for name, ramp in self._ramps.items()} | {quantity: target}
        # A slow drift may be at its start when another one has ended; the number of steps only rises.
        most = {name: max(now[name], ends[name]) for name in DRIFTING}
        coldest = min(now["oil_temperature"], ends["oil_temperature"])
        if coldest != self._temperature:
            most["viscous_coefficient"] *= float(self._oil.ratio(np.array(coldest)))
        period, highest = 1.0 / self.sample_rate, self.excitation.highest_frequency
        needed = composed_motion.substeps_for(self.model.terms, {**self._values, **most}, period, highest)
        if self._streams:  # they take each step of so many
            needed = -(-needed // self._every) * self._every
        self._substeps = max(self._substeps, needed)
        self._ramps[quantity] = _Ramp(now[quantity], target, self._moved, round(duration * self.sample_rate))

    def next_block(self) -> Block:
        """Return the next block."""
        return self._block(self._sample, *self._read(self.block_size))

    def records(self, seconds: float) -> Iterator[Block]:
        """Yield the blocks of the next ``seconds`` (whole blocks, rounded up) as fast as possible.

        The blocks are those of :meth:`next_block`, bit for bit; memory does not grow with ``seconds``.

        Raises:
            InputError: ``seconds`` is not a number > 0.
        """
        if not (math.isfinite(seconds) and seconds > 0.0):
            raise InputError(f"seconds: {seconds:g} must be a number > 0")
        return self._records(math.ceil(round(seconds * self.sample_rate, 6) / self.block_size))

    def _records(self, blocks: int) -> Iterator[Block]:
        count_read = max(1, _INNER_SAMPLES // self.block_size)
        size = self.block_size
        while blocks > 0:
            count = min(blocks, count_read)
            first = self._sample
            body, spool = self._read(count * size)
            for number in range(count):
                part = slice(number * size, (number + 1) * size)
                yield self._block(first + number * size, body[part], spool[part])
            blocks -= count

    def _block(self, first: int, body: Samples, spool: Samples) -> Block:
        offset = round(first * 1_000_000_000 / self._rate)
        return Block(self._start_stamp + offset, first // self.block_size, self.sample_period, body, spool)

    def _read(self, samples: int) -> tuple[Samples, Samples]:
        """Return the readings (float32, shape (samples,)) of body and spool, and move on."""
        while self._ready.shape[1] < samples:
            self._advance(_PIECE if self._streams else samples)
        (body, spool), self._ready = self._ready[:, :samples], self._ready[:, samples:]
        self._sample += samples
        readings = self._body_channel.read(body), self._spool_channel.read(spool)
        return readings[0].astype(np.float32), readings[1].astype(np.float32)

    def _advance(self, samples: int) -> None:
        """Move the spool on; add what both channels pass on of it to what is ready."""
        forcing = self.excitation.acceleration(
            composed_motion.half_step_times(self._moved, samples, self.sample_rate, self._substeps)
        )
        index = np.arange(self._moved, self._moved + samples)
        values: dict[str, float | NDArray[np.float64]] = dict(self._values)
        for name, ramp in self._ramps.items():
            moves = ramp.start != ramp.target or ramp.first > self._moved
            values[name] = ramp.at(index) if moves else ramp.target
        if self._warms:
            values["viscous_coefficient"] *= self._oil.ratio(self._ramps["oil_temperature"].at(index))
        if self.strokes is not None:
            values["push"] = self.strokes.push(index / self.sample_rate)
        points, self._state = self._motion.read(
            self._state,
            forcing,
            self._motion.table(values, samples),
            sample_period=self.sample_period,
            substeps=self._substeps,
            first_sample=self._moved,
        )
        fine = self._substeps // self._every if self._streams else self._substeps
        both: tuple[Array, ...] = forcing[: -1 : 2 * fine], points.acceleration[::fine]
        if self._streams:
            events = np.zeros((0, 3)), points.events * (1.0 / fine, 1.0, fine)
            both = tuple(stream.take(*one) for stream, *one in zip(self._streams, both, events, strict=True))
        early = max(0, self._streams[0].lead - self._moved) if self._streams else 0
        self._moved += samples
        self._ready = np.hstack([self._ready, np.array(both)[:, early:]])
