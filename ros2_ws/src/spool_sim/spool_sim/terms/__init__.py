"""Force terms: one file, one class, one registry entry each."""

from __future__ import annotations

from .base import Parameter, Term
from .registry import TERMS, term

__all__ = ["TERMS", "Parameter", "Term", "term"]
