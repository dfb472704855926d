"""Compiled kernels on disk: their folder, and files that are sealed so that damage is seen.

numba loads machine code from these files and runs it. A bit that flipped, or a file that a power loss cut
off, would crash the process or raise any error: a file whose checksum differs is compiled again.

This module alone knows private parts of numba (checked with 0.68.1), which has no public check of its files.
Until a kernel is compiled it loads only Python's own library: ``./spool doctor`` needs no numba.
"""

from __future__ import annotations

import hashlib
import importlib
import logging
import multiprocessing
import os
import pickle
import re
import tempfile
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from typing import Any, ClassVar

from spool_core import system

#: How the name of a file ends, as numba names what it keeps of a signature.
DATA = ".nbc"
#: What takes long on a first start, for people.
COMPILING = "compiling the numerical kernels (first start only)"
#: First bytes of each file. Another layout of the files needs another number here.
MAGIC = b"spool kernel 1\n"
#: First byte of the files that earlier releases kept without a checksum, where nothing looks for them now.
_PLAIN = b"\x80"
_DIGEST_SIZE = hashlib.sha256().digest_size
#: s after which kernels of another state of their code are taken away: chosen, then they compile again.
OUTDATED = 30 * 86_400

_log = logging.getLogger(__name__)
_warned: set[Path] = set()


def sealed(name: str, content: bytes) -> bytes:
    """Return ``content`` of the file called ``name`` with its checksum in front."""
    return MAGIC + _digest(name, content) + content


def unsealed(name: str, stored: bytes) -> bytes:
    """Return the content of the file called ``name``.

    Raises:
        ValueError: the file is damaged.
    """
    content = stored[len(MAGIC) + _DIGEST_SIZE :]
    if stored[: len(MAGIC) + _DIGEST_SIZE] != MAGIC + _digest(name, content):
        raise ValueError("its checksum differs")
    return content


def damaged_files(folder: Path) -> list[Path]:
    """Return the kernel files in ``folder`` and below that cannot be read or whose checksum differs."""
    found = []
    for path in sorted(folder.rglob(f"*{DATA}")):
        try:
            stored = path.read_bytes()
            if not stored.startswith(_PLAIN):
                unsealed(path.name, stored)
        except FileNotFoundError:  # another process has just removed it
            continue
        except (OSError, ValueError):
            found.append(path)
    return found


def keep_on_disk(kernel: object, digest: Callable[[], str]) -> None:
    """Store the compiled forms of the dispatcher ``kernel`` in sealed files.

    Does nothing to a function that numba does not compile (``NUMBA_DISABLE_JIT``).

    Args:
        kernel: the dispatcher.
        digest: returns a hash of all that is compiled into it, as it is when it is called.
    """
    if hasattr(kernel, "_cache"):
        kernel._cache = KernelCache(f"{kernel.__module__}.{kernel.__qualname__}", digest)  # type: ignore[attr-defined]


class KernelCache:
    """Compiled forms of one kernel: what numba's ``FunctionCache`` does, by a hash of all that is in them.

    numba looks at the kernel's own file only: a change in a function that it calls, or in a constant that it
    takes from another module, would find the old kernel. It also keeps an index of its files; here the name
    of a file tells what is in it, so that processes that compile at one time change no file of each other.
    """

    #: Called with 1 where a kernel begins to compile and with -1 where it is ready, if a program shows that.
    watch: ClassVar[Callable[[int], None] | None] = None

    def __init__(self, name: str, digest: Callable[[], str]) -> None:
        """Take the full name of the kernel, and what returns the hash of the code as it is when called."""
        self._name = re.sub(r"[<>]", "", name)
        self._digest = digest

    @property
    def cache_path(self) -> str:
        """Where the files are."""
        return str(kernel_folder())

    def enable(self) -> None:
        """Stay enabled."""

    def disable(self) -> None:
        """Stay enabled: numba itself disables no cache."""

    def flush(self) -> None:
        """Forget all that is kept of the code as it is."""
        for path in kernel_folder().glob(f"{self._name}-{self._digest()[:16]}.*"):
            path.unlink(missing_ok=True)

    def load_overload(self, signature: Any, target: Any) -> Any:
        """Return the compiled form for ``signature``, or ``None``."""
        target.refresh()
        kept = _loaded(kernel_folder() / self._file_name(signature, target.codegen()))
        if kept is None:
            if KernelCache.watch is not None:
                KernelCache.watch(1)
            return None
        return importlib.import_module("numba.core.compiler").CompileResult._rebuild(target, *kept)

    def save_overload(self, signature: Any, result: Any) -> None:
        """Keep ``result`` of compiling for ``signature``, unless it holds an address of this process.

        Where the disk does not take it, the kernel is used without a copy.
        """
        if KernelCache.watch is not None:
            KernelCache.watch(-1)
        if result.library.has_dynamic_globals or not all(one.can_cache for one in result.lifted):
            return
        folder, name = kernel_folder(), self._file_name(signature, result.codegen)
        content = importlib.import_module("numba.core.serialize").dumps(result._reduce())
        try:
            folder.mkdir(parents=True, exist_ok=True)
            system.write_durably(folder / name, sealed(name, content), mode=system.FILE_MODE)
            # What is kept of the same kernel for other states of its code is old after a time.
            for path in folder.glob(f"{self._name}-*"):
                with suppress(FileNotFoundError):  # another process has just removed it
                    outdated = path.stat().st_mtime < time.time() - OUTDATED
                    if outdated and path.name.partition(".")[0] != name.partition(".")[0]:
                        path.unlink()
        except OSError as error:
            _warn(folder, "compiled kernels are not kept in %s: %s", folder, error.strerror)

    def _file_name(self, signature: Any, codegen: Any) -> str:
        """Return the name by what a compiled form depends on: code, types of the arguments, processor, numba.

        numba compares named tuples by their class and the types of their fields, which may change places.
        """
        fields: list[tuple[str, str, tuple[str, ...]]] = []
        waiting = list(getattr(signature, "args", signature))
        while waiting:
            kind = waiting.pop()
            if hasattr(kind, "instance_class"):
                made = kind.instance_class
                fields.append((made.__module__, made.__qualname__, tuple(kind.fields)))
            waiting += getattr(kind, "types", ())
            waiting += [one for name in ("dtype", "type") if (one := getattr(kind, name, None)) is not None]
        digest, version = self._digest(), importlib.import_module("numba").__version__
        key = repr((digest, version, str(signature), codegen.magic_tuple(), fields))
        return f"{self._name}-{digest[:16]}.{hashlib.sha256(key.encode()).hexdigest()[:16]}{DATA}"


def _loaded(path: Path) -> Any:
    """Return what the file holds, ``None`` without it, or if it is damaged or a class in it is renamed."""
    try:
        return pickle.loads(unsealed(path.name, path.read_bytes()))
    except (FileNotFoundError, AttributeError, ImportError):
        return None
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        text = "kernel file %s cannot be read (%s): its kernel is compiled again"
        _warn(path.parent.parent, text, path, reason)
        return None


def wanted_kernel_folder(environment: Mapping[str, str]) -> Path:
    """Return ``$NUMBA_CACHE_DIR/spool_kernels``, else the place in the user's cache folder.

    Raises:
        RuntimeError: no home directory.
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
    who = system.others_may_write(folder)
    if who is not None:
        return f"{who}, and code is loaded from there"
    try:
        system.private_folder(folder)
        with tempfile.TemporaryFile(dir=folder):
            return None
    except OSError as error:
        return f"it can't be written ({error.strerror})"


@lru_cache(maxsize=8)
def usable_kernel_folder(wanted: Path | None) -> Path:
    """Return ``wanted`` where kernels may be kept there, else a private temporary folder, said once."""
    reason = "no home directory" if wanted is None else refusal(wanted)
    if wanted is not None and reason is None:
        return wanted
    other = system.private_temporary_folder("kernels")
    if multiprocessing.parent_process() is None:
        text = "compiled kernels are not kept in %s: %s; they are kept in %s"
        _log.warning(text, wanted or "~/.cache", reason, other)
    return other


def kernel_folder() -> Path:
    """Return where this process keeps kernels."""
    try:
        wanted = wanted_kernel_folder(os.environ)
    except RuntimeError:
        wanted = None
    return usable_kernel_folder(wanted)


def _digest(name: str, content: bytes) -> bytes:
    return hashlib.sha256(name.encode() + b"\n" + content).digest()


def _warn(about: Path, text: str, *arguments: object) -> None:
    """Log a warning, the first about each folder of a process; the others, and those of workers, as debug."""
    first = about not in _warned and multiprocessing.parent_process() is None
    _warned.add(about)
    _log.log(logging.WARNING if first else logging.DEBUG, text, *arguments)
