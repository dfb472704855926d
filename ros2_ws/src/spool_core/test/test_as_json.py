"""Results as JSON: every kind of value, and the metadata of fields."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
from spool_core.uncertainty import BY_NAME, EMPTY_IS_NULL, LEFT_OUT, Quantity, Validity, as_json, named


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        (None, None),
        (True, True),
        (3, 3),
        (0.5, 0.5),
        (math.nan, None),
        (-math.inf, None),
        (np.float32(0.5), 0.5),
        (np.int64(3), 3),
        (np.array([[1.0, math.nan], [2.0, 3.0]]), [[1.0, None], [2.0, 3.0]]),
        (("a", 1.0), ["a", 1.0]),
        ({"a": (math.nan,)}, {"a": [None]}),
        (Path("bags/practice_03"), "bags/practice_03"),
        (Validity.HELD, "held"),
        (Quantity("mass", "kg", 0.18, math.nan, Validity.VALID), {"value": 0.18, "std": None, "unit": "kg"}),
    ],
)
def test_each_kind_of_value(value: Any, expected: Any) -> None:
    assert as_json(value) == expected
    json.dumps(as_json(value), allow_nan=False)


@dataclass(frozen=True, slots=True)
class Part:
    """Entry of a result."""

    name: str
    size: float = field(metadata=named("size_bytes"))


@dataclass(frozen=True, slots=True)
class Whole:
    """Result with every kind of field."""

    JSON_PROPERTIES: ClassVar = ("count",)

    parts: tuple[Part, ...] = field(metadata=BY_NAME)
    listed: tuple[Part, ...]
    hidden: object = field(default=None, metadata=LEFT_OUT)
    reason: str = field(default="", metadata=EMPTY_IS_NULL)

    @property
    def count(self) -> int:
        """How many parts it has."""
        return len(self.parts)


def test_a_dataclass_is_written_as_its_fields_say() -> None:
    part = Part("a", 1.0)
    written = as_json(Whole((part,), (part,), object()))
    assert written == {
        "parts": {"a": {"size_bytes": 1.0}},
        "listed": [{"name": "a", "size_bytes": 1.0}],
        "reason": None,
        "count": 1,
    }
    assert list(written) == ["parts", "listed", "reason", "count"]
    assert as_json(Whole((), (), reason="cut off")) == {
        "parts": {}, "listed": [], "reason": "cut off", "count": 0,
    }  # fmt: skip
