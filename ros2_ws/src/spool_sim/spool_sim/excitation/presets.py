"""Excitations by name, with defaults that suit springs of 10 to 30 Hz."""

from __future__ import annotations

from .base import Excitation
from .broadband import MachineOrders, Multisine
from .sines import Standstill, SteadySine, SteppedSine, SweptSine

PRESETS: dict[str, Excitation] = {
    "standstill": Standstill(),
    "steady": SteadySine(frequency=30.0, amplitude=10.0),
    # The paper's series ran from 10 to 100 Hz.
    "stepped": SteppedSine(
        start_frequency=10.0, stop_frequency=100.0, frequency_step=5.0, dwell=2.0, amplitude=10.0
    ),
    "sweep": SweptSine(start_frequency=10.0, stop_frequency=100.0, duration=20.0, amplitude=10.0),
    "multisine": Multisine(low_frequency=10.0, high_frequency=100.0, rms=7.0),
    "orders": MachineOrders(
        speed_profile=((0.0, 600.0), (20.0, 2400.0), (40.0, 2400.0), (60.0, 600.0)),
        orders=((1.0, 6.0), (2.0, 3.0)),
        broadband_rms=4.0,
    ),
}
