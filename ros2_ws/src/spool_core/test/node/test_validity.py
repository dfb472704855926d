from __future__ import annotations

import pytest
from spool_core.uncertainty import Validity
from spool_msgs.msg import Quantity


@pytest.mark.parametrize("validity", Validity)
def test_the_numbers_of_validity_are_those_of_the_message(validity: Validity) -> None:
    assert getattr(Quantity, f"VALIDITY_{validity.name}") == validity.value


def test_the_message_has_no_other() -> None:
    names = [name for name in dir(type(Quantity)) if name.startswith("VALIDITY_")]
    assert sorted(names) == sorted(f"VALIDITY_{validity.name}" for validity in Validity)
