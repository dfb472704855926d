"""Evidence of records of two accelerometers: every picture that they allow, for one or two models."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from spool_core.errors import InputError
from spool_estimator.identification.free_run import excitation_limit
from spool_estimator.identification.record import Record
from spool_sim.valve.description import Valve

from spool_tools.report.estimates.bands import bands_of
from spool_tools.report.estimates.cross_spectra import cross_spectra
from spool_tools.report.estimates.loops import loops_of
from spool_tools.report.estimates.runs import Numbers, Runs, of_one_rate, runs_of
from spool_tools.report.estimates.spectrogram import Spectrogram, rows_of, spectrogram
from spool_tools.report.estimates.whiteness import whiteness

from . import campbell as campbell_picture
from . import force_loops as loops_picture
from . import information_bands as bands_picture
from . import residual_whiteness as whiteness_picture
from . import transmissibility as transmissibility_picture
from .exhibit import Exhibit, LeftOut, made

#: Times the natural frequency that a spectrum over time shows at least, and of the excitation's limit.
HARMONICS, BEYOND = 4.0, 1.2


@dataclass(slots=True)
class AccelerationEvidence:
    """Evidence of ``records`` of one ``valve``; ``sides`` are one or two models, base first.

    ``frequencies`` gives the natural frequencies to draw over time; without it those of ``sides`` are drawn.
    """

    records: Sequence[Record]
    valve: Valve
    sides: Sequence[Numbers]
    frequencies: Mapping[str, campbell_picture.Frequency] | None = None
    _runs: Runs | None = field(default=None, init=False)

    def exhibits(self) -> list[Exhibit | LeftOut]:
        """Return every picture, or why it is left out, in the order in which an expert looks."""
        wanted: tuple[tuple[str, Callable[[], Exhibit]], ...] = (
            (bands_picture.TITLE, self._bands),
            (campbell_picture.TITLE, self._campbell),
            (transmissibility_picture.TITLE, self._transmissibility),
            (loops_picture.TITLE, self._loops),
            (whiteness_picture.TITLE, self._whiteness),
        )
        return [made(title, build) for title, build in wanted]

    def _bands(self) -> Exhibit:
        rows = of_one_rate(self.records)
        spectra = cross_spectra(
            [entry.body for entry in rows], [entry.spool for entry in rows], rows[0].sample_period
        )
        values = self.sides[-1].values if self.sides else {}
        names = ("mass", "viscous_coefficient", "spring_stiffness")
        known = [float(values.get(name, np.nan)) for name in names]
        return bands_picture.information_bands(bands_of(spectra, *known))

    def _campbell(self) -> Exhibit:
        rows = of_one_rate(self.records)
        limit = max(excitation_limit(entry) for entry in rows)
        highest = max(BEYOND * min(limit, 400.0), HARMONICS * self.valve.natural_frequency)
        shown = spectrogram(rows_of(rows), rows[0].sample_period, highest)
        return campbell_picture.campbell(shown, self.frequencies or self._constant(shown))

    def _constant(self, shown: Spectrogram) -> dict[str, campbell_picture.Frequency]:
        return {
            side.name: campbell_picture.constant(side.natural_frequency, shown)
            for side in self.sides
            if np.isfinite(side.natural_frequency)
        }

    def _transmissibility(self) -> Exhibit:
        return transmissibility_picture.transmissibility(self._both())

    def _loops(self) -> Exhibit:
        self._need_a_model()
        return loops_picture.force_loops(loops_of(self.records, self.sides))

    def _whiteness(self) -> Exhibit:
        runs = self._both()
        found = {name: whiteness(runs.residuals(name), runs.period) for name in runs.simulated}
        return whiteness_picture.residual_whiteness(found)

    def _need_a_model(self) -> None:
        if not self.sides:
            raise InputError("no model of this valve is known from the record")

    def _both(self) -> Runs:
        self._need_a_model()
        if self._runs is None:
            self._runs = runs_of(self.records, self.valve, self.sides)
        return self._runs
