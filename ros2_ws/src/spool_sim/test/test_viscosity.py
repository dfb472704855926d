from __future__ import annotations

from typing import Any

import pytest
from spool_core.errors import InputError
from spool_sim.valve import OILS, VISCOSITY_INDEX, Valve, valve_from_mapping


def test_temperature_law_needs_an_oil(valve_mapping: dict[str, Any]) -> None:
    del valve_mapping["oil"]
    with pytest.raises(InputError, match=r"valve 'valve_soft': oil: key is missing.* add one of HL68"):
        valve_from_mapping(valve_mapping).at(40.0)


@pytest.mark.parametrize("temperature", [-41.0, 151.0, float("nan"), float("inf")])
def test_temperatures_out_of_range_are_refused(valve: Valve, temperature: float) -> None:
    with pytest.raises(InputError, match=r"valve 'valve_soft': oil temperature: .*out of range.*-40 to 150"):
        valve.dynamic_viscosity_at(temperature)


def test_point_of_the_valve_out_of_range_is_refused(valve_mapping: dict[str, Any]) -> None:
    valve = valve_from_mapping({**valve_mapping, "oil_temperature": 200.0})
    with pytest.raises(InputError, match="200 deg C is out of range"):
        valve.dynamic_viscosity_at(40.0)


#: ASTM D2270, table 2: from, to (mm^2/s at 100 deg C), and the coefficients of L and H at 40 deg C.
D2270 = (
    (2.0, 3.8, (1.14673, 1.7576, -0.109), (0.84155, 1.5521, -0.077)),
    (3.8, 4.4, (3.38095, -15.4952, 33.196), (0.78571, 1.7929, -0.183)),
    (4.4, 5.0, (2.5, -7.2143, 13.812), (0.82143, 1.5679, 0.119)),
    (5.0, 6.4, (0.101, 16.635, -45.469), (0.04985, 9.1613, -18.557)),
    (6.4, 7.0, (3.35714, -23.5643, 78.466), (0.22619, 7.7369, -16.656)),
    (7.0, 7.7, (0.01191, 21.475, -72.870), (0.79762, -0.7321, 14.610)),
    (7.7, 9.0, (0.41858, 16.1558, -56.040), (0.05794, 10.5156, -28.240)),
    (9.0, 12.0, (0.88779, 7.5527, -16.600), (0.26665, 6.7015, -10.810)),
)


def viscosity_index(at_40: float, at_100: float) -> float:
    """Return the viscosity index by procedure A of ASTM D2270."""
    low, high = next((low, high) for first, last, low, high in D2270 if first <= at_100 <= last)
    (loosest, best) = (a * at_100**2 + b * at_100 + c for a, b, c in (low, high))
    return 100.0 * (loosest - at_40) / (loosest - best)


@pytest.mark.parametrize("grade", [10, 15, 22, 32, 46, 68, 100])
def test_a_grade_has_its_number_at_40_degrees_and_the_stated_viscosity_index(grade: int) -> None:
    oil = OILS[f"ISO VG {grade}"]
    assert oil.kinematic_viscosity(40.0) == pytest.approx(grade)
    index = viscosity_index(oil.kinematic_viscosity(40.0), oil.kinematic_viscosity(100.0))
    assert index == pytest.approx(VISCOSITY_INDEX, abs=1.0)
