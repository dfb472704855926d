"""Printed data of the paper: its measurement series, its fitted values, its model equations.

Stosiak, Karpenko, Deptula, Urbanowicz, Skackauskas, Cieslicki, Deptula: Modelling and Experimental
Verification of the Interaction in a Hydraulic Directional Control Valve Spool Pair (2022), CC BY. It prints
no measurements.
"""

from __future__ import annotations

from dataclasses import dataclass

from spool_sim.valve import Valve


@dataclass(frozen=True, slots=True)
class PaperSeries:
    """A pair of springs and an oil (tables 1 and 2).

    Attributes:
        number: as in table 1.
        spring_stiffness: equivalent of the pair, N/m.
        oil: name.
        dynamic_viscosity: Pa s, as printed.
        figure, ratio_figure: numbers of the paper's figures of amplitudes and of amplitude ratios.
    """

    number: int
    spring_stiffness: float
    oil: str
    dynamic_viscosity: float
    figure: int
    ratio_figure: int

    @property
    def label(self) -> str:
        """Short name, for legends and tables."""
        return f"{self.spring_stiffness:g} N/m, {self.oil}"

    @property
    def valve(self) -> Valve:
        """The valve of table 2 with this series' springs and oil."""
        return Valve(
            id=f"paper_series_{self.number}",
            moving_mass=0.18,
            spool_mass=0.172,
            spring_stiffness=self.spring_stiffness,
            land_diameter=0.020,
            land_length=0.032,
            radial_clearance=15e-6,
            dynamic_viscosity=self.dynamic_viscosity,
            oil=self.oil,
            oil_temperature=20.0,
        )


SERIES: tuple[PaperSeries, ...] = (
    PaperSeries(1, 1632.0, "Azolla ZS22", 0.0198, 6, 17),
    PaperSeries(2, 5846.0, "HL68", 0.0612, 7, 15),
    PaperSeries(3, 5846.0, "Azolla ZS22", 0.0198, 8, 16),
    PaperSeries(4, 1632.0, "HL68", 0.0612, 9, 14),
)


@dataclass(frozen=True, slots=True)
class PrintedModel:
    """One of the paper's four models and what the paper found for it.

    Attributes:
        number: as in the paper.
        name: of the model in this suite.
        equation, table: numbers in the paper.
        columns: what the table lists, with units.
        values: a row for each series, by its number, in SI units.
        objective: printed value of the objective by series number.
        mean_objective, mean_ratio: printed in table 7.
    """

    number: int
    name: str
    equation: str
    table: int
    columns: tuple[str, ...]
    values: dict[int, tuple[float, ...]]
    objective: dict[int, float]
    mean_objective: float
    mean_ratio: float


MODELS: tuple[PrintedModel, ...] = (
    PrintedModel(
        1, "microwedge", "(13)", 3, ("a_k0 (m)", "d_k0 (m)", "k_t (N/m)"),
        {
            1: (7.1717e-5, 0.0032, 99.985), 2: (1.9854e-6, 0.00732, 100.0),
            3: (2e-6, 8e-6, 100.0), 4: (0.00356, 0.00565, 46.86),
        },
        {1: 3.1135e7, 2: 7.618e7, 3: 1.0015e8, 4: 4.1084e7}, 6.27e7, 0.65,
    ),
    PrintedModel(
        2, "mixed", "(23)", 4, ("C1 (√(s/m))", "C2 (m/s)"),
        {1: (9.9684, 15.9903), 2: (9.9998, 9.9906), 3: (9.9998, 10.0046), 4: (10.0536, 9.6365)},
        {1: 8.98e6, 2: 1.81e7, 3: 1.72e7, 4: 1.67e7}, 1.52e7, 0.89,
    ),
    PrintedModel(
        3, "coulomb_hydrodynamic", "(28a)", 5, ("μ0 (-)", "K_V (-)"),
        {1: (0.03823, 0.025445), 2: (0.10885, -0.047217), 3: (0.10039, -0.0008), 4: (0.16025, 0.77652)},
        {1: 3.1519e7, 2: 7.4157e7, 3: 9.8865e7, 4: 2.4495e7}, 5.73e7, 0.70,
    ),
    PrintedModel(
        4, "fluid", "(29)", 6, ("h (m)",),
        {1: (8.7237e-5,), 2: (8.4188e-6,), 3: (1.9375e-5,), 4: (3.1171e-5,)},
        {1: 2.9153e7, 2: 2.9586e7, 3: 2.2014e7, 4: 2.5752e7}, 2.66e7, 0.40,
    ),
)  # fmt: skip


def printed_parameters(model: PrintedModel, series: PaperSeries) -> dict[str, float]:
    """Return the parameters, by this suite's names, that the paper's table gives for ``series``."""
    values = model.values[series.number]
    if model.name == "microwedge":
        overlap, length, proportionality = values
        return {
            "microwedge_overlap": overlap,
            "microwedge_length": length,
            "contact_proportionality": proportionality,
        }
    if model.name == "mixed":
        return {"mixed_root_coefficient": values[0], "mixed_inverse_coefficient": values[1]}
    if model.name == "coulomb_hydrodynamic":
        return {"dry_coefficient": values[0], "film_coefficient": values[1]}
    gap = series.valve.model_copy(update={"radial_clearance": values[0]})
    return {"viscous_coefficient": gap.viscous_coefficient}
