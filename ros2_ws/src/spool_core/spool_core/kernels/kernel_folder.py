"""Kernel folder: where kernels are kept; code is loaded from there, so nobody else may write in it."""

from __future__ import annotations

import logging
import multiprocessing
import os
import tempfile
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path

from spool_core.private import others_may_write, private_folder, private_temporary_folder


def wanted_kernel_folder(environment: Mapping[str, str]) -> Path:
    """Return ``$NUMBA_CACHE_DIR/spool_kernels``, else the place in the user's cache folder.

    Raises:
        RuntimeError: there is no home folder.
    """
    chosen = environment.get("NUMBA_CACHE_DIR")
    if chosen:
        return Path(chosen) / "spool_kernels"
    home = environment.get("XDG_CACHE_HOME")
    return (Path(home) if home else Path.home() / ".cache") / "spool_sim" / "kernels"


def refusal(folder: Path) -> str | None:
    """Return why kernels are neither loaded from ``folder`` nor kept there, ``None`` where they are.

    The folder is made, and restricted to its owner, where that is possible.
    """
    who = others_may_write(folder)
    if who is not None:
        return f"{who}, and code is loaded from there"
    try:
        private_folder(folder)
        with tempfile.TemporaryFile(dir=folder):
            return None
    except OSError as error:
        return f"it can't be written ({error.strerror})"


@lru_cache(maxsize=8)
def usable_kernel_folder(wanted: Path | None) -> Path:
    """Return ``wanted`` where kernels may be kept there, else a private temporary folder, said once."""
    reason = "there is no home folder" if wanted is None else refusal(wanted)
    if wanted is not None and reason is None:
        return wanted
    other = private_temporary_folder("kernels")
    if multiprocessing.parent_process() is None:
        logging.getLogger(__name__).warning(
            "compiled kernels are not kept in %s: %s; they are kept in %s",
            wanted or "~/.cache",
            reason,
            other,
        )
    return other


def kernel_folder() -> Path:
    """Return where this process keeps kernels."""
    try:
        wanted = wanted_kernel_folder(os.environ)
    except RuntimeError:
        wanted = None
    return usable_kernel_folder(wanted)
