"""Units of channels."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from spool_import.units.header import split_header
from spool_import.units.units import Sensitivity, converted, quantity_of
from spool_stream.errors import InputError


@pytest.mark.parametrize(
    ("unit", "size"),
    [
        ("g", 9.80665), ("m/s²", 1.0), ("m/s^2", 1.0), ("m s^-2", 1.0), ("m·s⁻²", 1.0), ("ms-2", 1.0),
        ("m/s/s", 1.0), ("(m/s2)", 1.0), ("mg", 9.80665e-3), ("mm/s²", 1e-3),
        ("Gal", 0.01), ("ft/s^2", 0.3048), ("in/s^2", 0.0254), ("g_n", 9.80665),
    ],
)  # fmt: skip
def test_accelerations_as_loggers_write_them(unit: str, size: float) -> None:
    assert quantity_of(unit) == "acceleration"
    assert float(converted(np.array([2.0]), unit, "acceleration")[0]) == pytest.approx(2.0 * size, rel=1e-12)


@pytest.mark.parametrize("unit", ["kg", "", "xyz", "m/s", "1", "__import__('os')", "m**99999", "g" * 100])
def test_what_is_no_acceleration_is_not_taken_for_one(unit: str) -> None:
    assert quantity_of(unit) != "acceleration"
    with pytest.raises(InputError):
        converted(np.array([1.0]), unit, "acceleration")


def test_temperatures_have_offsets() -> None:
    assert float(converted(np.array([32.0]), "degF", "temperature")[0]) == pytest.approx(0.0, abs=1e-9)
    assert float(converted(np.array([300.15]), "K", "temperature")[0]) == pytest.approx(27.0)


@pytest.mark.parametrize(
    ("header", "name", "unit"),
    [
        ("body [g]", "body", "g"), ("Gehäuse (m/s²)", "Gehäuse", "m/s²"), ("a / (m/s²)", "a", "m/s²"),
        ("spool in g", "spool", "g"), ("body, g", "body", "g"), ("body_m_s2", "body", "m_s2"), ("t", "t", ""),
        ("spool (left) [mV]", "spool (left)", "mV"), ("channel (left)", "channel (left)", ""),
        ("time_ms", "time", "ms"),
    ],
)  # fmt: skip
def test_headers_name_their_unit(header: str, name: str, unit: str) -> None:
    assert split_header(header) == (name, unit)


@given(st.floats(1e-3, 1e3), st.floats(-50.0, 50.0))
def test_a_sensitivity_gives_the_acceleration_back(size: float, acceleration: float) -> None:
    """A sensor of ``size`` mV/g reads acceleration times that."""
    reading = np.array([acceleration / 9.80665 * size])
    sensor = Sensitivity(f"{size!r}mV/g")
    assert float(sensor.acceleration(reading, "mV")[0]) == pytest.approx(acceleration, rel=1e-9, abs=1e-12)
    assert float(sensor.acceleration(reading * 1e-3, "V")[0]) == pytest.approx(
        acceleration, rel=1e-9, abs=1e-12
    )


@pytest.mark.parametrize("text", ["", "100", "mV/g", "100 kg", "0mV/g", "100mV/s", "g/g"])
def test_what_is_no_sensitivity_is_refused(text: str) -> None:
    with pytest.raises(InputError, match="100mV/g"):
        Sensitivity(text)


def test_a_sensitivity_for_volts_does_not_read_accelerations() -> None:
    with pytest.raises(InputError, match="for readings in mV"):
        Sensitivity("100mV/g").acceleration(np.ones(3), "g")
