"""Keys of diagnostics: one style, and the same from start to end."""

from __future__ import annotations

import re

import pytest
from spool_core.block_gate import BlockGate, Fault
from spool_core.node.diagnostics import block_faults, block_values, key


@pytest.mark.parametrize(
    ("name", "unit", "expected"),
    [
        ("amplification", "1", "amplification"),
        ("natural_frequency", "Hz", "natural_frequency_Hz"),
        ("spring_stiffness", "N/m", "spring_stiffness_N_per_m"),
        ("viscous_coefficient", "N s/m", "viscous_coefficient_N_s_per_m"),
        ("oil_temperature", "deg C", "oil_temperature_deg_C"),
        ("offset", "m/s^2", "offset_m_per_s2"),
    ],
)
def test_a_key_is_the_name_and_the_unit(name: str, unit: str, expected: str) -> None:
    assert key(name, unit) == expected


def test_the_keys_of_blocks_do_not_change_with_what_happens() -> None:
    gate = BlockGate()
    before = list(block_values(gate))
    assert all(re.fullmatch("[a-z0-9_]+", one) for one in before)
    gate.faults[Fault.LOST] = 1
    assert list(block_values(gate)) == before


def test_what_is_a_minute_old_is_no_fault_of_now() -> None:
    """One lost block must not show for the rest of a node's life."""
    gate = BlockGate()
    gate.lost = 3
    gate.recent.count(3, 1)
    assert block_faults(gate) == "3 blocks lost, 1 refused in the last minute"
    gate.recent.advance(62.0)
    assert block_faults(gate) == ""
    assert block_values(gate)["blocks_lost"] == 3
