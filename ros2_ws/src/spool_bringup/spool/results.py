"""Results of analyses: shown in a notebook, as text, as the command's JSON, as a page."""

from __future__ import annotations

import copy
import io
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console
from spool_core.errors import InputError
from spool_core.uncertainty import as_json
from spool_report import fit_tables
from spool_report.outputs import replacing, write_file, write_json
from spool_report.ranking import FittedSeries, Ranking, ValidatedFit
from spool_report.runs.fit_run import save_fit
from spool_report.terminal import warn

from spool.errors import one_error

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure
    from spool_design.setups import FittedSetUps
    from spool_design.what_if import WhatIf as Prediction
    from spool_report.runs.gap_run import FoundGap
    from spool_report.runs.record_quality import RecordQuality

#: Characters of a line of ``summary()`` and in a notebook.
WIDTH = 120


def recording() -> Console:
    """Return a console that shows nothing and records all. In a notebook rich would display each line."""
    return Console(
        file=io.StringIO(), width=WIDTH, record=True, color_system="truecolor", force_jupyter=False,
        force_terminal=False,
    )  # fmt: skip


@contextmanager
def keeping_backend() -> Iterator[None]:
    """Draw without a screen inside; afterwards matplotlib's backend and open figures are as they were."""

    from matplotlib import pyplot  # noqa: PLC0415 - who draws nothing needs none

    before, opened = pyplot.get_backend(), set(pyplot.get_fignums())
    try:
        pyplot.switch_backend("Agg")
        yield
    finally:
        for number in set(pyplot.get_fignums()) - opened:
            pyplot.close(number)
        pyplot.switch_backend(before)


@dataclass(frozen=True)
class Picture:
    """Picture that a notebook shows; ``figure`` is matplotlib's, for changes."""

    figure: Figure

    def save(self, path: str | Path) -> None:
        """Write it as PNG, SVG or PDF, by the ending of ``path``."""
        self.figure.savefig(path)

    def _repr_png_(self) -> bytes:
        stream = io.BytesIO()
        self.figure.savefig(stream, format="png", dpi=100)
        return stream.getvalue()


class Result(ABC):
    """Result of an analysis."""

    def __init__(self, data: Any) -> None:
        """Take what ``--json`` of the command writes."""
        self._data: dict[str, Any] = as_json(data)

    def to_dict(self) -> dict[str, Any]:
        """Return what ``--json`` of the command writes: SI units, ``None`` where a number is not known."""
        return copy.deepcopy(self._data)

    @abstractmethod
    def _print(self, console: Console) -> None:
        """Show on ``console`` what the command shows."""

    @abstractmethod
    def _page(self) -> str:
        """Return the page that ``--report`` of the command writes."""

    def summary(self) -> str:
        """Return what the command prints, as text."""
        console = recording()
        self._print(console)
        return console.export_text().rstrip()

    @one_error
    def save(self, path: str | Path, *, replace: bool = False) -> None:
        """Write the result: ``.json`` as ``to_dict``, ``.html`` as a page with pictures and tables.

        Args:
            path: file to write.
            replace: replace an existing file.

        Raises:
            InputError: another ending, or the file exists or cannot be written.
        """

        path = Path(path)
        if path.suffix not in (".json", ".html"):
            raise InputError(f"{path}: a result is saved as .json or .html: change the ending")
        with replacing(replace):
            if path.suffix == ".json":
                write_json(path, self._data)
            else:
                with keeping_backend():
                    page = self._page()
                write_file(path, page, "save")

    def __repr__(self) -> str:
        return self.summary()

    def _repr_html_(self) -> str:
        console = recording()
        self._print(console)
        return console.export_html(
            inline_styles=True, code_format='<pre style="line-height:1.3">{code}</pre>'
        )


class Quality(Result):
    """Quality of a record: rate, gaps, noise, coherence, resonance, and what speaks against an estimate."""

    def __init__(self, found: RecordQuality, notes: Sequence[str]) -> None:
        super().__init__({**as_json(found), "notes": notes})
        self._found, self._notes = found, notes

    @property
    def doubts(self) -> list[str]:
        """What speaks against an estimate from the record, a sentence each; empty if nothing does."""
        return list(self._data["doubts"])

    def _print(self, console: Console) -> None:
        from spool_report.runs.record_quality import print_quality  # noqa: PLC0415

        print_quality(self._found, self._notes, console)

    def _page(self) -> str:
        from spool_report.runs.record_quality import quality_page  # noqa: PLC0415

        return quality_page(self._found, self._notes)


class _Fitted(Result):
    """Result of a fit."""

    @property
    def parameters(self) -> dict[str, dict[str, Any]]:
        """Value, standard deviation and unit by name: ``{"coulomb_force": {"value":, "std":, "unit":}}``."""
        return dict(self._data["parameters"])

    @property
    def determined(self) -> dict[str, dict[str, Any]]:
        """Judgement of what the records determine of each parameter: ``verdict``, ``sentence`` and more."""
        return dict(self._data["determined"])

    @property
    def reason(self) -> str | None:
        """Why there is no result, ``None`` if there is one."""
        return None if (reason := self._data["reason"]) is None else str(reason)

    def _need_result(self, what: str) -> None:
        """Refuse ``what`` where there is no result."""
        if self.reason is not None:
            raise InputError(f"{what}: {self.reason}")


class Fit(_Fitted):
    """Parameters of one model, fitted to records."""

    def __init__(self, validated: ValidatedFit) -> None:
        super().__init__(fit_tables.to_dictionary(validated))
        self._validated = validated

    @property
    def nrmse(self) -> float:
        """Rms of simulated less measured spool acceleration over that of the measured one, on held-out data.

        On the fitted data if the records are too short to hold a part out.
        """
        held_out = self._validated.held_out
        return self._validated.training_error if held_out is None else held_out.nrmse

    @one_error
    def to_frame(self) -> pd.DataFrame:
        """Return the parameters as a pandas table: a row each, columns ``value``, ``std``, ``unit``.

        Raises:
            InputError: pandas is not installed.
        """
        import pandas as pd  # noqa: PLC0415 - an extra

        return pd.DataFrame.from_dict(self.parameters, orient="index", columns=["value", "std", "unit"])

    @one_error
    def plot(self) -> Picture:
        """Return measured and simulated spool acceleration, and their difference.

        Raises:
            InputError: the fit has no result.
        """
        found = self._validated.fit
        self._need_result(f"{found.model.name}: no result to plot")
        with keeping_backend():
            from spool_report import fit_curves, fit_page  # noqa: PLC0415

            data = self._validated.data
            shown = fit_curves.overlay(data.fitted, found, data.valve)
            return Picture(
                fit_page.waveform_figure({found.model.name: shown}, fit_curves.excerpts(shown.run))
            )

    @one_error
    def save_model(self, path: str | Path) -> None:
        """Write the fitted model as a YAML file, for ``model=`` of ``spool.simulate`` and others.

        Raises:
            InputError: the fit has no result, or the file exists or cannot be written.
        """
        self._need_result(f"{path}: no model to save")
        save_fit(Path(path), self._validated)

    def _print(self, console: Console) -> None:
        if self.reason is not None:
            console.print(f"no result: {self.reason}", markup=False, highlight=False, soft_wrap=True)
            return
        fit_tables.print_fit(self._validated, console)

    def _page(self) -> str:
        self._need_result("no result to save as a page")
        from spool_report.fit_page import fit_page  # noqa: PLC0415

        return fit_page(self._validated)


class SetUpsFit(_Fitted):
    """Parameters of one model, fitted to several set-ups of one valve together.

    ``spring_stiffness[soft, loaded]`` is the parameter of these two; ``determined`` judges all together.
    """

    def __init__(self, found: FittedSetUps) -> None:
        from spool_design.setups import to_dictionary  # noqa: PLC0415 - an add-on

        super().__init__(to_dictionary(found))
        self._found = found

    @property
    def alone(self) -> dict[str, dict[str, dict[str, Any]]]:
        """Judgement of what each set-up by itself determines, by its name."""
        return dict(self._data["alone"])

    @property
    def fits(self) -> dict[str, Fit]:
        """What the joint fit reports of each set-up, by its name; empty without a result."""
        pairs = zip(self._found.setups, self._found.validated, strict=False)
        return {setup.name: Fit(one) for setup, one in pairs}

    def _print(self, console: Console) -> None:
        from spool_design.setups import print_setups  # noqa: PLC0415 - an add-on

        print_setups(self._found, console)

    def _page(self) -> str:
        self._need_result("no result to save as a page")
        from spool_design.setups_page import setups_page  # noqa: PLC0415

        return setups_page(self._found)


class Comparison(Result):
    """Models side by side on records, best first."""

    def __init__(self, series: Sequence[FittedSeries], ranking: Ranking) -> None:
        super().__init__(fit_tables.comparison_dictionary(series, ranking))
        self._series, self._ranking = series, ranking

    @property
    def preferred(self) -> str | None:
        """Name of the model that the records prefer, ``None`` if no model has a result."""
        return self._ranking.preferred

    @property
    def fits(self) -> dict[str, Fit]:
        """Fit of each model to the first series of records, by the model's name."""
        return {one.name: Fit(one) for one in self._series[0].validated}

    @one_error
    def to_frame(self) -> pd.DataFrame:
        """Return the ranking as a pandas table, a row for each model, best first.

        Raises:
            InputError: pandas is not installed.
        """
        import pandas as pd  # noqa: PLC0415 - an extra

        rows = [{**row, "error": row["error"]["value"]} for row in self._data["ranking"]]
        return pd.DataFrame(rows).set_index("model")

    def _print(self, console: Console) -> None:
        fit_tables.print_comparison(self._series, self._ranking, console)

    def _page(self) -> str:
        if self.preferred is None:
            raise InputError("no model has a result to save as a page: see summary()")
        from spool_report.fit_page import compare_page  # noqa: PLC0415

        return compare_page(self._series, self._ranking)


class Gap(Result):
    """What a model lacks: the effects that were found, and the error before and after."""

    def __init__(self, found: FoundGap, made_from: Sequence[tuple[str, str]]) -> None:
        from spool_gap.report import result_to_dict  # noqa: PLC0415 - slow to load

        super().__init__(result_to_dict(found.result))
        self._found, self._made_from = found, made_from

    @property
    def verdict(self) -> str:
        """Effects that were found, joined by ``+``; ``none`` or ``unexplained``."""
        return str(self._data["verdict"])

    @property
    def effects(self) -> list[dict[str, Any]]:
        """The effects with their parameters, errors before and after, meaning, and what to check."""
        return list(self._data["effects"])

    @property
    def confidence(self) -> float:
        """Probability that the verdict is right, 0 to 1."""
        return float(self._data["confidence"])

    @one_error
    def save_model(self, path: str | Path) -> None:
        """Write the model with what was found as a YAML file, for ``model=`` of other functions.

        Raises:
            InputError: the file exists or cannot be written, or no model file may state what was found.
        """
        from spool_report.runs.gap_run import save_found  # noqa: PLC0415

        save_found(Path(path), self._found.result)

    def _print(self, console: Console) -> None:
        from spool_report.runs import gap_run  # noqa: PLC0415

        result = self._found.result
        gap_run.print_determined(result.determinations, console)
        for warning in result.warnings:
            warn(warning, console)
        gap_run.show(result, console)

    def _page(self) -> str:
        from spool_report.runs.gap_run import page_of  # noqa: PLC0415

        return page_of(self._found, self._made_from)


class Replay(Result):
    """Estimates and events of the live estimator and monitor over a record."""

    def __init__(self, found: Mapping[str, Any], page: str) -> None:
        super().__init__(found)
        self._html = page

    @property
    def events(self) -> list[dict[str, Any]]:
        """Events of all valves, each with the valve's name as ``valve``, in order of time."""
        every = [
            {"valve": name, **event} for name, one in self._data["valves"].items() for event in one["events"]
        ]
        return sorted(every, key=lambda event: float(event["t_s"]))

    def _print(self, console: Console) -> None:
        from spool_report.runs.record_replay import print_replay  # noqa: PLC0415

        print_replay(self._data, console)

    def _page(self) -> str:
        if not self._html:
            raise InputError("this replay has no page: call spool.replay with report=True")
        return self._html


class WhatIf(Result):
    """Response of a valve under changed conditions, beside that of today."""

    def __init__(self, found: Prediction) -> None:
        super().__init__(found)
        self._found = found

    @property
    def before(self) -> dict[str, Any]:
        """Response today: lists over ``frequency_Hz``, ``resonances`` and what to ``avoid``."""
        return dict(self._data["before"])

    @property
    def after(self) -> dict[str, Any]:
        """Response after the change, as ``before``."""
        return dict(self._data["after"])

    @one_error
    def plot(self) -> Picture:
        """Return amplitude ratio and stroke over frequency, today and after the change."""
        with keeping_backend():
            from spool_design.what_if_page import response_figure  # noqa: PLC0415

            return Picture(response_figure(self._found))

    def _print(self, console: Console) -> None:
        from spool_design.what_if import print_what_if  # noqa: PLC0415 - an add-on

        print_what_if(self._found, console)

    def _page(self) -> str:
        from spool_design.what_if_page import what_if_page  # noqa: PLC0415

        return what_if_page(self._found)
