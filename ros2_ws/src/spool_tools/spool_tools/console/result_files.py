"""Files that an analysis is asked to write."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from spool_core.errors import InputError

from .outputs import STANDARD_OUTPUT, check_output


@dataclass(frozen=True, slots=True)
class ResultFiles:
    """Files to write, ``None`` for those not wanted; ``folder`` gives those a place that are not named."""

    json: Path | None = None
    report: Path | None = None
    model: Path | None = None
    folder: Path | None = None

    def within(self, stem: str, *, model: bool = False) -> ResultFiles:
        """Return these with every file of ``folder`` named; the folder is made.

        Raises:
            InputError: the folder cannot be made, or a file in it is there already.
        """
        if self.folder is None:
            return self
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(f"--out {self.folder}: cannot be made: {error.strerror}") from error
        named = ResultFiles(
            self.json or self.folder / f"{stem}.json",
            self.report or self.folder / f"{stem}.html",
            self.model or (self.folder / "model.yaml" if model else None),
        )
        for path in (named.json, named.report, named.model):
            if path != STANDARD_OUTPUT:
                check_output(path, "--out")
        return named
