"""What reaches a terminal steers nothing there."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st
from spool_core.text import printable


@given(st.text(st.characters(exclude_categories=()), max_size=50))
def test_no_character_is_left_that_a_terminal_acts_on(text: str) -> None:
    shown = printable(text)
    assert shown.isprintable()
    assert not {"\x1b", "\x9b", "\x07", "\r", "\n", "\b", "\u202e"} & set(shown)
    shown.encode("utf-8")


def test_ordinary_names_stay_as_they_are() -> None:
    for text in ("/valve_1/acceleration", "Prüfstand 3, µm, 20 °C, ±0.1 m/s²", "阀门", ""):
        assert printable(text) == text


def test_an_escape_sequence_is_shown_instead_of_followed() -> None:
    assert printable("/\x1b[2Jvalve\n") == "/\\x1b[2Jvalve\\n"


def test_a_long_text_is_cut() -> None:
    assert printable("x" * 7_900_000, 100) == "x" * 97 + "..."
