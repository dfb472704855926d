from __future__ import annotations

import math
import re
from decimal import Decimal
from pathlib import Path

import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st
from spool_core.uncertainty import UNKNOWN, Z_95, Shown, compared, exact, interval, number, with_interval

SIZES = st.floats(-1e12, 1e12).filter(lambda one: one == 0.0 or abs(one) > 1e-15)
DEVIATIONS = st.floats(1e-15, 1e12)


def last_digit(text: str) -> Decimal:
    """Return the place value of the last digit that ``text`` shows, e.g. 0.001 of 0.498."""
    mantissa, _, power = text.partition("e")
    return Decimal(1).scaleb(int(power or 0) - len(mantissa.partition(".")[2]))


@pytest.mark.parametrize(
    ("value", "half_width", "shown"),
    [
        (0.49768, 0.0112, "0.498 ± 0.011 N"),
        (8.20097, 0.008733, "8.2010 ± 0.0087 N"),
        (1632.2, 0.996, "1632.2 ± 1.0 N"),
        (-0.00000577, 0.0021, "0.0000 ± 0.0021 N"),
        (-0.00000577, 0.0000011, "-5.8e-6 ± 1.1e-6 N"),
        (58467.3, 1234.0, "58500 ± 1200 N"),
        (1632.0, 0.0, "1632 ± 0 N"),
        (1632.0, math.nan, "1632 ± unknown N"),
        (1632.0, math.inf, "1632 ± unknown N"),
        (1632.0, -1.0, "1632 ± unknown N"),
        (0.0, math.nan, "0 ± unknown N"),
        (math.nan, 1.0, "unknown"),
        (math.inf, 1.0, "unknown"),
    ],
)
def test_the_half_widths_two_digits_decide_what_is_shown(value: float, half_width: float, shown: str) -> None:
    assert with_interval(value, half_width / Z_95, "N") == shown


@given(value=SIZES, deviation=DEVIATIONS)
@example(value=9.9999, deviation=0.0509)
@example(value=-0.0, deviation=1e-9)
@example(value=9999999.9, deviation=0.6)
@example(value=1.25, deviation=1.25)
@example(value=-1.25, deviation=1.25)
def test_the_interval_shown_covers_the_one_meant_to_its_last_digit(value: float, deviation: float) -> None:
    shown = interval(value, deviation)
    assert last_digit(shown.value) == last_digit(shown.half_width)
    # Of 1200 the hundreds are the last digit that means something.
    digit = max(last_digit(shown.half_width), Decimal(1).scaleb(Decimal(shown.half_width).adjusted() - 1))
    centre, half = Decimal(shown.value), Decimal(shown.half_width)
    exact = Decimal(repr(value))  # as it is read: the shortest decimal that is this double
    assert half > 0
    assert centre - half - digit <= exact - Decimal(Z_95 * deviation)
    assert centre + half + digit >= exact + Decimal(Z_95 * deviation)
    assert abs(centre - exact) <= digit / 2
    assert not (centre == 0 and shown.value.startswith("-"))


@given(value=SIZES, deviation=DEVIATIONS)
def test_two_digits_of_the_half_width_are_shown_where_a_double_holds_them(
    value: float, deviation: float
) -> None:
    assume(abs(value) < 1e10 * deviation)
    shown = interval(value, deviation)
    digits = shown.half_width.partition("e")[0].replace(".", "").lstrip("0")
    assert len(digits) == 2 or not digits[2:].strip("0")


@given(value=SIZES, deviation=DEVIATIONS)
def test_no_number_is_a_row_of_noughts_or_wider_than_a_column(value: float, deviation: float) -> None:
    assume(abs(value) < 1e6 * deviation)
    for text in (interval(value, deviation).value, interval(value, deviation).half_width):
        assert len(text) <= 16
        assert "e+" not in text


@given(pairs=st.lists(st.tuples(SIZES, DEVIATIONS), min_size=2, max_size=4))
def test_what_is_compared_shares_its_last_digit(pairs: list[tuple[float, float]]) -> None:
    shown = compared(*pairs)
    assert len({last_digit(one.value) for one in shown}) == 1
    assert all(Decimal(one.half_width) > 0 for one in shown)


@given(value=st.sampled_from([math.nan, math.inf, -math.inf]), deviation=st.floats())
def test_what_is_not_known_is_said_so(value: float, deviation: float) -> None:
    assert interval(value, deviation) == Shown(UNKNOWN, UNKNOWN)
    assert with_interval(value, deviation, "N") == number(value) == UNKNOWN


@given(value=st.floats(-1e15, 1e15).filter(lambda one: one == 0.0 or abs(one) > 1e-15))
def test_a_number_without_interval_keeps_four_digits(value: float) -> None:
    assert float(number(value)) == pytest.approx(value, rel=5.1e-4)


@pytest.mark.parametrize(
    ("value", "text"),
    [(12345.6, "12346"), (0.5, "0.5000"), (1632.04, "1632"), (-5.77e-6, "-5.770e-6"), (0.0, "0")],
)
def test_a_number_is_written_without_needless_powers_of_ten(value: float, text: str) -> None:
    assert number(value) == text


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.18, "0.18"), (1632.0, "1632"), (15.0e-6, "1.5e-5"), (0.0, "0"), (1e5, "100000"), (math.nan, UNKNOWN)],
)
def test_a_number_that_is_given_has_no_noughts_at_its_end(value: float, text: str) -> None:
    assert exact(value) == text


def test_no_other_place_writes_an_interval() -> None:
    packages = Path(__file__).parents[2]
    sources = [path for path in packages.glob("spool_*/spool_*/**/*.py") if path.name != "uncertainty.py"]
    assert len(sources) > 100
    assert [str(path) for path in sources if re.search("± ?[{%]", path.read_text(encoding="utf-8"))] == []
