"""Force terms, each one declaration, in files by family; a module of users may add its own."""

from __future__ import annotations

from spool_core.discovery import objects_in
from spool_core.errors import InputError

from spool_sim.terms.base import Parameter, Term

__all__ = ["TERMS", "Parameter", "Term", "term"]

TERMS: dict[str, Term] = {
    entry.name: entry for entry in sorted(objects_in(__package__, Term), key=lambda entry: entry.name)
}


def term(name: str) -> Term:
    """Return the term called ``name``.

    Raises:
        InputError: no such term.
    """
    if name not in TERMS:
        raise InputError(f"terms: unknown force term '{name}'; known are {', '.join(TERMS)}")
    return TERMS[name]
