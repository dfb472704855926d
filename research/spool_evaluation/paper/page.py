"""Page of the reproduction: figures and tables in the paper's order, and what they tell."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
from markupsafe import Markup
from matplotlib.figure import Figure
from spool_sim.sensors import PAPER_CHAIN
from spool_tools.operations.valve_sheet import SPEED
from spool_tools.report import page as html

from . import figures
from .claims import CAN, CANNOT
from .data import MODELS, SERIES, PrintedModel
from .regimes import STROKE, verdict
from .reproduction import SEED, Reproduction, locked
from .simulation import NOISE, TRUTH, Plan, sensors
from .tables import TableRow

TITLE = "A spool in a vibrating body: the paper's models on made data"
#: Share of the objective that a further step may promise for a fit to count as converged; the ranks of the
#: models differ by more.
LEVEL = 0.01


def assumptions(plan: Plan) -> list[str]:
    """Return what the made data rest on, one line each."""
    body, spool = (100.0 * sensor.gain_error for sensor in sensors(SEED))
    static, kinetic = TRUTH["static_force"], TRUTH["coulomb_force"]
    first, last = plan.frequencies[0], plan.frequencies[-1]
    return [
        "The authors' measurements are not published. Every 'measured' number here is simulated.",
        "Truth: fluid friction (12) with table 2, and dry friction that falls with speed (Stribeck), from "
        f"{static:g} N at rest to {kinetic:g} N, by exp(-(v/v_s)^2) with v_s = "
        f"{TRUTH['stribeck_velocity']:g} m/s. It is none of the four models.",
        f"Shaker: {len(plan.frequencies)} steps from {first:g} to {last:g} Hz of {plan.dwell:g} s, "
        f"{plan.amplitude:g} m/s^2 peak throughout; the last {plan.window:g} s of each count. The only "
        "motion in the paper's text is far larger: 60 Hz with a full spool stroke of 9 mm, above 0.5 m/s.",
        f"Measuring chain: (30) to (32) with 5 %; drawn gain errors {body:+.2f} % (body) and {spool:+.2f} % "
        f"(spool), noise {NOISE:g} m/s^2.",
        "Fits: free-run simulations driven by the measured body amplitude, waveforms compared, sigma_i from "
        "the 5 % (as even bounds) and the noise. The sum of squares is minimised; (33) as printed is only "
        "evaluated.",
    ]


def sections(out: Path, results: Reproduction, tables: Mapping[str, list[TableRow]]) -> list[Markup]:
    """Return the sections of the page; the pictures go into the folder ``out`` as PNG, too."""

    def drawn(name: str, figure: Figure, description: str) -> Markup:
        text, content = html.picture(figure, description)
        (out / f"{name}.png").write_bytes(content)
        return text

    series_4 = SERIES[3]
    found = [
        html.heading("What the data are"), html.listing(assumptions(results.plan)),
        html.heading("What can be reproduced without the authors' measurements"), html.listing(CAN),
        html.heading("What cannot"), html.listing(CANNOT),
        html.heading("What follows from tables 1 and 2"),
        html.paragraph(
            f"(6): fluid friction coefficient eta = mu v A / (F_N h) under the spool's weight at {SPEED:g} "
            "m/s, what Coulomb's coefficient would have to be for Newton's drag. Lambda: gap height over "
            "combined rms roughness; fluid friction from 3 on, mixed from 1 on. (31): largest error of the "
            f"measuring chain, {100.0 * PAPER_CHAIN.relative_uncertainty:.3g} % of the reading."
        ),
        html.table(list(tables["derived"][0]), tables["derived"]),
        html.heading("Amplitude over frequency: figures 6 to 11"),
        drawn("figures_6_to_9", figures.amplitude_figure(results.data), "amplitudes of body and spool"),
        drawn("figures_10_and_11", figures.comparison_figure(results.data), "all series together"),
        html.heading("Fitted parameters: tables 3 to 6"),
    ]  # fmt: skip
    for model in MODELS:
        rows = tables[f"table_{model.table}"]
        found += [
            html.paragraph(_about(model)),
            html.table(list(rows[0]), rows),
        ]
    found += [
        html.paragraph(
            "Intervals (± 95 %) come from the curvature of the objective: they say how sharp its least "
            "value is, not how far a model that is not the truth may be off. 'unknown': the data do not tell."
        ),
        html.heading("The objective: figure 12 and table 7"),
        drawn("figure_12", figures.objective_figure(results.fits), "objective by model and series"),
        html.table(list(tables["table_7"][0]), tables["table_7"]),
        html.heading("Waveform at 60 Hz: figure 13"),
        drawn("figure_13", figures.waveform_figure(results.data[4], series_4, results.fits), "waveforms"),
        html.heading("Amplitude ratios: figures 14 to 17"),
        drawn("figures_14_to_17", figures.ratio_figure(results.data, results.fits), "amplitude ratios"),
        html.heading("Table 4 locks the spool"), *_lock(results, drawn),
        html.heading("Two regimes of motion"),
        html.paragraph(
            f"The paper's conclusions name a spool that oscillates at 60 Hz with a full stroke of "
            f"{1e3 * STROKE:g} mm. For that regime the body is shaken, at each step up to 60 Hz, as much as "
            "fluid friction alone needs for that stroke. Forces at the step nearest to 60 Hz, in the truth:"
        ),
        html.table(list(tables["forces_in_both_regimes"][0]), tables["forces_in_both_regimes"]),
        html.paragraph(
            "All four models fitted in both regimes, h held at 15 µm but in model 4; means over the four "
            f"series. {verdict(tables['models_in_both_regimes'])} Gains of 5 % are in both, so that at full "
            "stroke, where dry friction is a small part of all forces, they count for more than it does."
        ),
        html.table(list(tables["models_in_both_regimes"][0]), tables["models_in_both_regimes"]),
        html.heading("Models that contain model 4"),
        html.paragraph(
            "Model 3 contains model 4 for any h: mu_0 = 0 and K_V = 1 - (15 µm)/h. A converged fit of it "
            "never has the larger objective, but three of the four printed ones do: those fits did not "
            "converge, were bounded, or follow another equation; the text does not tell which. Models 1 "
            "and 2 contain model 4 only with h fitted and may lose to it with h held. The fits here start "
            "from what they contain, so none ends above it. "
            f"{_convergence(results)} Objectives with h held at 15 µm and with h fitted:"
        ),
        html.table(
            list(tables["objective_with_h_fitted"][0]), tables["objective_with_h_fitted"]
        ),
    ]  # fmt: skip
    return found


def _lock(results: Reproduction, drawn: Callable[[str, Figure, str], Markup]) -> list[Markup]:
    series = SERIES[3]
    root, inverse = MODELS[1].values[series.number]
    weight = series.valve.spool_mass * 9.80665
    speed = np.linspace(0.0, 3.0, 601)
    force = (root * np.sqrt(speed) + inverse / (speed + 0.01)) * weight
    followed = [label for label, same in locked(results).items() if same]
    inertia = series.valve.moving_mass * results.plan.amplitude
    loose = force[0] / series.valve.moving_mass
    say = (
        f"Equation (23) with table 4 takes up to {force[0]:.0f} N at rest and never less than "
        f"{force.min():.0f} N at any speed, against an inertia force of {inertia:.2g} N. Simulated, spool "
        f"and body move as one, a_spool = a_body bit for bit, in {len(followed)} of {len(SERIES)} series. "
        f"The body would have to be shaken with {loose:.0f} m/s^2 to break the spool loose. A locked "
        "spool has no resonance and does not depend on the oil, but the text tells of resonances near 15 and "
        "30 Hz that the oil changes, so these values were not at work as (23) is printed."
    )
    figure = figures.lock_figure(
        series, results.data[4], results.printed[4, "mixed"], (speed.tolist(), force.tolist())
    )
    return [html.paragraph(say), drawn("table_4_locks_the_spool", figure, "locked spool")]


def _about(model: PrintedModel) -> str:
    """Return the caption of a model's table."""
    caption = f"Table {model.table}: model {model.number}, equation {model.equation}"
    if model.name != "microwedge":
        return caption
    return (
        f"{caption}. By (14), k_t = C_k mu_s: contact stiffness times coefficient of static friction. With "
        "mu_s = 0.1, as of steel on steel in oil, 100 N/m stand for a contact of 1 kN/m."
    )


def _convergence(results: Reproduction) -> str:
    """Return a sentence on how many fits are at a point where the objective is level."""
    every = [*results.fits.values(), *results.free.values()]
    level = sum(one.decrease < LEVEL for one in every)
    return (
        f"In {level} of {len(every)} fits a step of Gauss and Newton promises less than {100.0 * LEVEL:g} % "
        "of the objective; in the others the spool sticks, the objective has kinks there, and its slopes "
        "promise what a search around the point did not find."
    )
