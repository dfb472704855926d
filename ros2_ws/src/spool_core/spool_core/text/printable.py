"""Printable text: names from files and networks must not steer the terminal that shows them."""

from __future__ import annotations


def printable(text: object, longest: int = 2000) -> str:
    """Return ``text`` with every character that is not printable (Unicode) written as its escape.

    Args:
        text: of any origin.
        longest: characters kept; what is longer ends in ``...``.
    """
    whole = str(text)
    cut = whole if len(whole) <= longest else whole[: longest - 3] + "..."
    return cut if cut.isprintable() else "".join(map(_shown, cut))


def _shown(letter: str) -> str:
    if letter.isprintable():
        return letter
    return letter.encode("unicode_escape", "surrogatepass").decode("ascii")
