from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from spool_core.errors import InputError
from spool_sim.excitation import (
    PRESETS,
    Excitation,
    MachineOrders,
    Multisine,
    Sequence,
    SteppedSine,
    SweptSine,
    from_mapping,
    load_excitation,
)

SEQUENCE: dict[str, Any] = {
    "kind": "sequence",
    "fade": 0.5,
    "parts": [
        {"duration": 3.0, "excitation": {"kind": "standstill"}},
        {"duration": 4.0, "excitation": {"kind": "steady_sine", "frequency": 12, "amplitude": 5}},
        {
            "duration": 5.0,
            "excitation": {"kind": "multisine", "low_frequency": 10, "high_frequency": 80, "rms": 3},
        },
    ],
}

EVERY: dict[str, Excitation] = {
    **PRESETS,
    "stepped by list": SteppedSine(frequencies=(20.0, 55.0, 10.0), dwell=0.7, amplitude=4.0),
    "swept back": SweptSine(start_frequency=90.0, stop_frequency=9.0, duration=4.0, amplitude=4.0),
    "swept by octaves": SweptSine(
        start_frequency=9.0, stop_frequency=90.0, duration=4.0, amplitude=4.0, scale="logarithmic"
    ),
    "swept again": SweptSine(
        start_frequency=9.0, stop_frequency=90.0, duration=4.0, amplitude=4.0, repeat="restart"
    ),
    "swept and held": SweptSine(
        start_frequency=9.0, stop_frequency=90.0, duration=4.0, amplitude=4.0, repeat="hold"
    ),
    "sequence": from_mapping(SEQUENCE),
    "sequence again": from_mapping({**SEQUENCE, "repeat": True}),
}
each = pytest.mark.parametrize("excitation", EVERY.values(), ids=EVERY.keys())


def peak_bound(excitation: Excitation) -> float:
    """Return an upper bound of the acceleration, m/s^2."""
    if isinstance(excitation, Sequence):
        return max(peak_bound(part.excitation) for part in excitation.parts) * 2.0
    if isinstance(excitation, Multisine):
        return excitation.rms * float(np.sqrt(2.0 * excitation.lines))
    if isinstance(excitation, MachineOrders):
        lines = excitation.broadband_rms * float(np.sqrt(2.0 * excitation.broadband_lines))
        return lines + sum(amplitude for _, amplitude in excitation.orders)
    return float(getattr(excitation, "amplitude", 0.0))


@each
def test_nothing_jumps(excitation: Excitation) -> None:
    step = 1e-5
    t = np.arange(0.0, 26.0, 1e-2)[:, None] + step * np.arange(2)
    value = excitation.acceleration(t.ravel()).reshape(t.shape)
    # Around every border of steps, runs and parts as well: whole tenths are among the times.
    borders = np.arange(1, 260) / 10.0
    across = excitation.acceleration(borders + 0.5 * step) - excitation.acceleration(borders - 0.5 * step)
    steepest = 2.0 * np.pi * max(excitation.highest_frequency, 20.0) * peak_bound(excitation)
    assert np.abs(np.diff(value)).max() <= 1.05 * steepest * step
    assert np.abs(across).max() <= 1.05 * steepest * step


@each
def test_starts_from_zero_and_stays_finite(excitation: Excitation) -> None:
    assert abs(float(excitation.acceleration(np.zeros(1))[0])) < 1e-12
    late = excitation.acceleration(1e6 + np.arange(1000) / 2000.0)
    assert np.isfinite(late).all()
    assert np.abs(late).max() <= 1.001 * peak_bound(excitation) + 1e-12


@each
def test_each_value_depends_on_its_own_time_alone(excitation: Excitation) -> None:
    t = np.arange(0.0, 13.0, 1.0 / 700.0)
    whole = excitation.acceleration(t)
    pieces = np.concatenate([excitation.acceleration(part) for part in np.array_split(t, 37)])
    np.testing.assert_array_equal(pieces, whole)
    np.testing.assert_array_equal(excitation.acceleration(t[::-1])[::-1], whole)


@pytest.mark.parametrize("seeded", ["multisine", "orders"])
def test_the_seed_makes_the_phases(seeded: str) -> None:
    t = np.arange(1.0, 2.0, 1e-3)
    one = PRESETS[seeded]
    other = one.model_copy(update={"seed": 5})
    np.testing.assert_array_equal(one.acceleration(t), one.model_copy().acceleration(t))
    assert np.abs(one.acceleration(t) - other.acceleration(t)).max() > 1.0


@pytest.mark.parametrize(
    ("mapping", "said"),
    [
        ({}, "kind: key is missing"),
        ({"kind": "square"}, "unknown kind 'square'; use one of standstill, steady_sine"),
        ({"kind": "steady_sine", "frequency": 10}, "amplitude: key is missing"),
        ({"kind": "steady_sine", "frequency": 10, "amplitude": 1, "colour": 3}, "colour: unknown key"),
        ({"kind": "steady_sine", "frequency": -10, "amplitude": 1}, "frequency: .*greater than 0"),
        ({"kind": "stepped_sine", "dwell": 1, "amplitude": 1}, "give either frequencies"),
        (
            {"kind": "stepped_sine", "dwell": 1, "amplitude": 1, "frequencies": [9], "start_frequency": 3},
            "not both",
        ),
        ({"kind": "multisine", "low_frequency": 20, "high_frequency": 10, "rms": 1}, "below low_frequency"),
        (
            {"kind": "machine_orders", "speed_profile": [[0, 600], [0, 700]], "orders": []},
            "times of speed_profile must rise",
        ),
        ({"kind": "sequence", "parts": []}, "parts"),
        ({**SEQUENCE, "fade": 9.0}, "fade is longer"),
        ({**SEQUENCE, "repeat": True, "parts": SEQUENCE["parts"][:1]}, "two parts or more"),
    ],
)
def test_wrong_excitation_is_refused_in_one_line(mapping: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError, match=said) as caught:
        from_mapping(mapping, "excitation.yaml")
    assert str(caught.value).startswith("excitation.yaml: ")
    assert "\n" not in str(caught.value)


def test_load_by_name_or_file(tmp_path: Path) -> None:
    assert load_excitation("sweep") is PRESETS["sweep"]
    path = tmp_path / "excitation.yaml"
    path.write_text(
        "kind: swept_sine\nstart_frequency: 10\nstop_frequency: 1e2\nduration: 5\namplitude: 8\n", "utf-8"
    )
    assert load_excitation(path) == SweptSine(
        start_frequency=10.0, stop_frequency=100.0, duration=5.0, amplitude=8.0
    )
    with pytest.raises(InputError, match=r"no such excitation; give one of standstill, steady"):
        load_excitation("sweeep")
