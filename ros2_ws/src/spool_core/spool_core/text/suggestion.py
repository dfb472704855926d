"""Suggestion of the name that was meant, for messages about one that does not exist."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from pathlib import PurePath

#: Least similarity of a name that is suggested: difflib's own default.
SIMILAR = 0.6


def did_you_mean(given: str, known: Iterable[str]) -> str:
    """Return ``"; did you mean NAME?"`` for the known name nearest to ``given``, empty where none is near.

    Upper and lower case, ``-`` for ``_`` and the folder and ending of a path make no difference.
    """
    by_form = {_form(name): name for name in known}
    for form in (_form(given), _form(PurePath(given).stem)):
        near = difflib.get_close_matches(form, by_form, n=1, cutoff=SIMILAR)
        if near:
            return f"; did you mean {by_form[near[0]]}?"
    return ""


def _form(name: str) -> str:
    return name.lower().replace("-", "_").replace(" ", "_")
