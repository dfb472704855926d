"""Model: a named list of force terms."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator
from spool_core.errors import InputError
from spool_core.files import file_of
from spool_core.numbers import Array
from spool_core.text import did_you_mean

from spool_sim.integration.composition import unique_parameters
from spool_sim.terms import Parameter, Term, term
from spool_sim.valve import NotNegative, Number, Valve, one_line, read_mapping

NEEDED: tuple[str, ...] = ("inertia", "spring")
#: By which a correlation matrix that was written with all its digits may be off.
_ROUNDING = 1e-6


class Uncertainty(BaseModel):
    """Uncertainty of fitted parameters, normally distributed around their values.

    Attributes:
        parameters: names.
        std: standard deviations, in the parameters' units.
        correlation: rows of the correlation matrix.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    parameters: tuple[str, ...] = Field(min_length=1)
    std: tuple[NotNegative, ...]
    correlation: tuple[tuple[Number, ...], ...]

    @model_validator(mode="after")
    def _fits_together(self) -> Uncertainty:
        count = len(self.parameters)
        if len(set(self.parameters)) != count:
            raise ValueError("parameters: a name is listed twice")
        if len(self.std) != count or [len(row) for row in self.correlation] != [count] * count:
            raise ValueError(f"std and correlation must have {count} rows, one for each parameter")
        matrix = np.array(self.correlation)
        if not np.allclose(matrix, matrix.T, atol=_ROUNDING) or not np.allclose(matrix.diagonal(), 1.0):
            raise ValueError("correlation: must be symmetric with 1 on its diagonal")
        if float(np.linalg.eigvalsh(matrix)[0]) < -_ROUNDING * count:
            raise ValueError("correlation: no parameters can vary together like this (negative eigenvalue)")
        return self

    def deviations(self, count: int, seed: int = 0) -> Array:
        """Return draws of what the parameters deviate by, in their units, shape (count, parameters)."""
        levels, vectors = np.linalg.eigh(np.array(self.correlation))
        root = vectors * np.sqrt(np.maximum(levels, 0.0))
        drawn = np.random.default_rng(seed).standard_normal((count, len(self.std)))
        return np.asarray(drawn @ root.T * np.array(self.std))


@dataclass(frozen=True)
class Model:
    """Force terms that add up to zero, with the values that differ from the terms' start values.

    Attributes:
        name: as in reports.
        terms: in the order of the list.
        values: parameter values by name, in their units.
        uncertainty: of those that were fitted, ``None`` where it is not known.
    """

    name: str
    terms: tuple[Term, ...]
    values: Mapping[str, float] = field(default_factory=dict)
    uncertainty: Uncertainty | None = None

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Parameters of all terms, in their order; one shared by two terms stands once."""
        return unique_parameters(self.terms)

    def parameter(self, name: str, where: str = "model") -> Parameter:
        """Return the parameter called ``name``.

        Raises:
            InputError: the model has none of that name.
        """
        for parameter in self.parameters:
            if parameter.name == name:
                return parameter
        known = ", ".join(parameter.name for parameter in self.parameters)
        near = did_you_mean(name, (parameter.name for parameter in self.parameters))
        raise InputError(
            f"{where}: {name}: unknown parameter of model '{self.name}', known are {known}{near}"
        )

    def values_for(self, valve: Valve, overrides: Mapping[str, float] | None = None) -> dict[str, float]:
        """Return all parameter values: override, else the model's own, else the valve's, else the start.

        Raises:
            InputError: an override that the model does not have, or a value out of range.
        """
        given = {**self.values, **(overrides or {})}
        for name in given:
            self.parameter(name)
        return {
            parameter.name: parameter.check(
                float(given.get(parameter.name, parameter.start_for(valve))), f"model '{self.name}'"
            )
            for parameter in self.parameters
        }

    def values_as(self, other: Model, values: Mapping[str, float], valve: Valve) -> dict[str, float] | None:
        """Return values with which the model does what ``other`` does with ``values``.

        ``None`` unless it has the terms of ``other``, or terms that become them, and more of them.
        """
        theirs, own = ({one.name for one in model.terms} for model in (other, self))
        left, found = theirs - own, {**self.values_for(valve), **values}
        for one in self.terms:
            if one.name not in theirs:
                name = next((name for name in one.becomes if name in left), "")
                left.discard(name)
                found |= one.becomes[name](found) if name in one.becomes else {}
        if left or theirs == own:
            return None
        return {one.name: min(max(found[one.name], one.low), one.high) for one in self.parameters}

    def narrower(self) -> Model | None:
        """Return the model with a term in place of one that contains it, ``None`` if none does."""
        for place, one in enumerate(self.terms):
            for name in filter(None, one.becomes):
                return Model(name, (*self.terms[:place], term(name), *self.terms[place + 1 :]))
        return None

    def true_values_for(self, valve: Valve, overrides: Mapping[str, float] | None = None) -> dict[str, float]:
        """Return the values as :meth:`values_for`, for a valve that acts instead of one that is fitted.

        Raises:
            InputError: as there, or the drag would be a guess as the valve's film is not described.
        """
        found = self.values_for(valve, overrides)
        if {"viscous_coefficient", "film_drag"} & found.keys() - (
            overrides or {}
        ).keys() - self.values.keys():
            _ = valve.viscous_coefficient  # raises what is missing
        return found


FLUID: tuple[str, ...] = ("inertia", "spring", "viscous_friction")
EFFECTS: tuple[str, ...] = (
    "adhesion_friction",
    "asymmetric_friction",
    "constant_force",
    "cubic_stiffness",
    "damping_drift",
    "detachment_friction",
    "end_stop",
    "hess_soom_friction",
    "pavelescu_friction",
    "periodic_force",
    "presliding_friction",
    "quadratic_damping",
    "seal_friction",
    "spring_backlash",
    "spring_preload",
    "tustin_friction",
)


def _model(name: str, *more: str) -> Model:
    return Model(name, tuple(term(entry) for entry in (*FLUID, *more)))


#: The paper's models 4, 1, 2 and 3, and single effects.
MODELS: dict[str, Model] = {
    model.name: model
    for model in (
        _model("fluid"),
        _model("coulomb", "coulomb_friction"),
        _model("stribeck", "stribeck_friction"),
        _model("microwedge", "microwedge_friction"),
        _model("mixed", "mixed_friction"),
        _model("coulomb_hydrodynamic", "coulomb_hydrodynamic_friction"),
        *(_model(f"fluid_{effect}", effect) for effect in EFFECTS),
    )
}


class _ModelFile(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")

    name: str = Field(min_length=1, max_length=100)
    terms: tuple[str, ...] = Field(min_length=1)
    parameters: dict[str, Number] = Field(default_factory=dict)
    uncertainty: Uncertainty | None = None


def model_from_mapping(mapping: Mapping[str, Any], where: str = "model") -> Model:
    """Return the model that ``mapping`` describes: ``name``, ``terms`` and, where wished, ``parameters``
    and their ``uncertainty``.

    Raises:
        InputError: unknown key, term or parameter, or a value out of range.
    """
    try:
        content = _ModelFile.model_validate(dict(mapping))
    except ValidationError as error:
        raise one_line(error, where, tuple(_ModelFile.model_fields)) from None
    for name in (*NEEDED, *content.terms):
        if content.terms.count(name) != 1:
            raise InputError(f"{where}: terms: '{name}' must stand in the list exactly once")
    try:
        terms = tuple(term(name) for name in content.terms)
        model = Model(content.name, terms, content.parameters, content.uncertainty)
        unique_parameters(model.terms)
    except InputError as error:
        raise InputError(f"{where}: {error}") from None
    for name, value in content.parameters.items():
        model.parameter(name, where).check(value, where)
    for name in () if content.uncertainty is None else content.uncertainty.parameters:
        model.parameter(name, f"{where}: uncertainty")
    return model


def load_model(name_or_path: str | Path) -> Model:
    """Return a model by its name, or the one that a YAML file describes.

    Raises:
        InputError: neither a known model nor a readable file with a valid one.
    """
    known = MODELS.get(str(name_or_path))
    if known is not None:
        return known
    path = file_of(name_or_path, "model", MODELS)
    return model_from_mapping(read_mapping(path, "model"), str(path))
