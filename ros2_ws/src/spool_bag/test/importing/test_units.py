"""Units of channels."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from spool_bag.importing.units import WORDS, Sensitivity, converted, level_of, quantity_of, split_header
from spool_core.errors import InputError


@pytest.mark.parametrize(
    ("unit", "size"),
    [
        ("g", 9.80665), ("m/s²", 1.0), ("m/s^2", 1.0), ("m s^-2", 1.0), ("m·s⁻²", 1.0), ("ms-2", 1.0),
        ("m/s/s", 1.0), ("(m/s2)", 1.0), ("mg", 9.80665e-3), ("mm/s²", 1e-3),
        ("Gal", 0.01), ("ft/s^2", 0.3048), ("in/s^2", 0.0254), ("g_n", 9.80665),
        ("G", 9.80665), ("gn", 9.80665), ("g0", 9.80665), ("g's", 9.80665), ("mG", 9.80665e-3),
        ("MG", 9.80665e-3),
        ("µg", 9.80665e-6), ("ug", 9.80665e-6), ("m/s**2", 1.0), ("m·s-2", 1.0), ("m.s-2", 1.0),
        ("m.s⁻²", 1.0),
        ("ms⁻²", 1.0), ("ms^-2", 1.0), ("m/sec2", 1.0), ("m/sec/sec", 1.0), ("m/(s*s)", 1.0),
        ("m/(s^2)", 1.0),
        ("m/s^(2)", 1.0), ("M/S2", 1.0), ("MM/S2", 1e-3), ("mps2", 1.0), ("meters per second squared", 1.0),
        ("mm/s2", 1e-3), ("cm/s²", 0.01), ("µm/s²", 1e-6), ("gal", 0.01), ("mGal", 1e-5), ("㎨", 1.0),
        ("ｇ", 9.80665),
        ("m／s²", 1.0), ("m/s 2", 1.0), ("m/sÂ²", 1.0), ("м/с²", 1.0), ("米/秒²", 1.0), ("G's", 9.80665),
    ],
)  # fmt: skip
def test_accelerations_as_loggers_write_them(unit: str, size: float) -> None:
    assert quantity_of(unit) == "acceleration"
    assert float(converted(np.array([2.0]), unit, "acceleration")[0]) == pytest.approx(2.0 * size, rel=1e-12)


#: Units that loggers write and that are no accelerations: what they measure, "" where they are not known.
OTHERS = {
    "mm/s": "velocity", "m/s": "velocity", "ips": "velocity", "km/h": "velocity", "bar": "pressure",
    "MPa": "pressure",
    "psi": "pressure", "Hz": "frequency", "1/min": "frequency", "U/min": "frequency", "rpm": "frequency",
    "V": "voltage", "mV": "voltage", "Volt": "voltage", "µV": "voltage", "VDC": "voltage", "counts": "count",
    "LSB": "count", "raw": "count", "digits": "count", "ADC": "count", "FS": "reading", "%FS": "reading",
    "%": "ratio", "mA": "current", "pC": "charge", "mm": "length", "µm": "length", "kN": "force", "s": "time",
    "ms": "time", "Sek": "time", "°C": "temperature", "℃": "temperature", "deg": "angle",
    "deg/s": "angular velocity",
    "l/min": "flow", "kg": "mass", "Nm": "torque or energy", "dB": "level", "g pk": "", "gpk": "",
    "g RMS": "",
    "grms": "", "g p-p": "", "m/s² rms": "", "a/g": "", "mV/V": "", "MV": "", "Mg": "", "Gs": "", "m/s?": "",
    "furlong": "", "hh:mm:ss": "", "-": "",
}  # fmt: skip


@pytest.mark.parametrize(("unit", "quantity"), OTHERS.items())
def test_other_units_are_known_by_what_they_measure_or_not_at_all(unit: str, quantity: str) -> None:
    assert quantity_of(unit) == quantity


@pytest.mark.parametrize(
    ("unit", "base"), [("g pk", "g"), ("gRMS", "g"), ("m/s² (peak)", "m/s2"), ("mm/s RMS", "mm/s")]
)
def test_a_statistic_is_told_from_samples(unit: str, base: str) -> None:
    level = level_of(unit)
    assert level is not None
    assert level[0] == base


@given(st.sampled_from(["body", "Acc 1", "Gehäuse links", "ch.1", "a-b"]), st.sampled_from(sorted(OTHERS)),
       st.sampled_from(["{} [{}]", "{}[{}]", "{} ({})", "{} {{{}}}", "{} <{}>"]))  # fmt: skip
@settings(max_examples=300)
def test_what_stands_in_brackets_is_never_taken_for_no_unit(name: str, unit: str, form: str) -> None:
    assert split_header(form.format(name, unit)) == (name, unit)


@given(st.text(st.characters(exclude_categories=("C", "Z")), min_size=1, max_size=12))
@settings(max_examples=500)
def test_any_text_in_square_brackets_is_a_unit_or_a_channels_name(text: str) -> None:
    if set(text) & set("[](){}<>"):
        return
    name, unit = split_header(f"x1 [{text}]")
    assert (name, unit) == ("x1", text) or text.casefold() in {
        word for words in WORDS.values() for word in words
    }
    assert quantity_of(unit) != "acceleration" or converted(np.ones(1), unit, "acceleration")[0] > 0.0


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
        ("time_ms", "time", "ms"), ("a/g", "a", "g"), ("body (a/g)", "body", "a/g"),
        ("body_mm_s", "body", "mm_s"),
        ("body_g_rms", "body", "g rms"), ("body_counts", "body", "counts"), ("CH1V", "CH1", "V"),
        ("[g] body", "body", "g"), ("acc [m/s²] left", "acc left", "m/s²"), ("CH1 (body)", "CH1 (body)", ""),
        ("body (2)", "body (2)", ""), ("body [-]", "body", "-"), ("body []", "body []", ""),
        ("acc (m/(s*s))", "acc", "m/(s*s)"), ("speed, rpm", "speed", "rpm"), ("Zeit/s", "Zeit", "s"),
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


@pytest.mark.parametrize(
    ("text", "unit", "size"),
    [
        ("1.25e-6g/count", "counts", 1.25e-6 * 9.80665), ("2 mg/LSB", "", 2e-3 * 9.80665),
        ("100 mV per g", "V", 98.0665),
        ("0.1V/(m/s^2)", "V", 10.0), ("50g/FS", "%FS", 0.5 * 9.80665), ("10pC/g", "pC", 0.980665),
        ("0.5mA/g", "A", 19613.3),
        ("50 m/s^2", "FS", 50.0),
    ],
)  # fmt: skip
def test_sensitivities_of_all_kinds_of_sensors(text: str, unit: str, size: float) -> None:
    assert Sensitivity(text).scale(unit) == pytest.approx(size, rel=1e-9)


@pytest.mark.parametrize("text", ["", "100", "mV/g", "100 kg", "0mV/g", "100mV/s", "g/g"])
def test_what_is_no_sensitivity_is_refused(text: str) -> None:
    with pytest.raises(InputError, match="100mV/g"):
        Sensitivity(text)


def test_a_sensitivity_for_volts_does_not_read_accelerations() -> None:
    with pytest.raises(InputError, match="for readings in mV"):
        Sensitivity("100mV/g").acceleration(np.ones(3), "g")
