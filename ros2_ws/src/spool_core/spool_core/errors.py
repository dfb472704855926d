"""Input error: what a user can put right."""

from __future__ import annotations


class InputError(ValueError):
    """Input or usage is wrong; the message says in one line what, where and what to do.

    The command line prints it as it is and exits with 2; a node refuses the transition.
    """
