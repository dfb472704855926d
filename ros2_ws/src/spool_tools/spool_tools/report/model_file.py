"""Model file: YAML that simulator and estimator load, with the deviation of each number that was fitted."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

from spool_core.quantity import Quantity
from spool_core.uncertainty import width
from spool_sim.model import Model

from spool_tools.console.outputs import write_file

#: Characters of a model's name that its file keeps; with what is added it stays below the 100 that are read.
LONGEST_NAME = 93


def save_model(
    path: Path, model: Model, name: str, values: Mapping[str, float], fitted: Sequence[Quantity], comment: str
) -> None:
    """Write ``model`` with ``values``.

    Args:
        path: to write.
        model: its terms are written.
        name: of the model in the file.
        values: by parameter, in its unit; parameters that are not among them are left out.
        fitted: what was fitted; the deviations of these stand next to their values.
        comment: first line, says where it comes from.

    Raises:
        InputError: the file cannot be written, or is there already.
    """
    known = {quantity.name: quantity for quantity in fitted}
    lines = [
        f"# {' '.join(comment.split())}",
        f"name: {name}",
        f"terms: [{', '.join(term.name for term in model.terms)}]",
        "parameters:",
    ]
    for parameter in model.parameters:
        if parameter.name in values:
            note = _note(known.get(parameter.name))
            lines.append(f"  {parameter.name}: {float(values[parameter.name])!r}  # {parameter.unit}, {note}")
    write_file(path, "\n".join(lines) + "\n", "--save-model")


def _note(quantity: Quantity | None) -> str:
    if quantity is None:
        return "held"
    if not math.isfinite(quantity.value):
        return "one choice of several that act alike"
    return width(quantity.value, quantity.standard_deviation)
