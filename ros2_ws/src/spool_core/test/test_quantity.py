from __future__ import annotations

import dataclasses
import math

import pytest
from spool_core.errors import InputError
from spool_core.uncertainty import Quantity, Validity


def test_a_quantity_is_unknown_until_said_otherwise() -> None:
    quantity = Quantity("coulomb_force", "N")
    assert math.isnan(quantity.value)
    assert math.isnan(quantity.standard_deviation)
    assert quantity.validity is Validity.UNKNOWN
    assert not quantity.known


@pytest.mark.parametrize(
    ("validity", "known"),
    [(Validity.UNKNOWN, False), (Validity.VALID, True), (Validity.HELD, True), (Validity.IMPLAUSIBLE, False)],
)
def test_only_valid_and_held_values_may_be_used(validity: Validity, known: bool) -> None:
    assert Quantity("coulomb_force", "N", 0.5, 0.01, validity).known is known


@pytest.mark.parametrize("field", [field.name for field in dataclasses.fields(Quantity)])
def test_a_quantity_cannot_be_changed(field: str) -> None:
    with pytest.raises(dataclasses.FrozenInstanceError):
        setattr(Quantity("coulomb_force", "N"), field, None)


def test_an_input_error_is_a_value_error() -> None:
    with pytest.raises(ValueError, match="use 1 to 10"):
        raise InputError("depth: 0 is out of range, use 1 to 10")
