"""Limits of the reproduction: what `./spool paper` can and cannot say."""

from __future__ import annotations

#: What the comparison can tell, and what only the authors' measurements could.
CAN: tuple[str, ...] = (
    "The undamped natural frequencies, 15.15 and 28.68 Hz, and the viscous coefficients of equation "
    "(12), 8.20 and 2.65 N s/m: they follow from table 2.",
    "What each of the four equations does at 10 to 100 Hz with given parameters, the printed ones included.",
    "Which parameters a fit by (33) can distinguish. In model 1 only the product k_t (d_k0 - a_k0) acts, "
    "so the three columns of table 3 are one number; in model 3 with the drag of (12) K_V only changes "
    "the viscous coefficient to (1 - K_V) of it.",
    "That some printed objectives cannot belong to converged fits of the equations as read here. Model 3 "
    "contains model 4 for any h: mu_0 = 0 and K_V = 1 - (15 µm)/h give its drag. Yet it is printed with a "
    "larger objective in three of the four series, by a factor of up to 4.5. Models 1 and 2 contain model 4 "
    "only with h fitted (last table).",
    "That the values of table 4 lock the spool (below).",
)
CANNOT: tuple[str, ...] = (
    "The printed objective values: they depend on the measured waveforms, their length and sigma, none "
    "of which is printed; (33) as printed is not squared, so that errors of opposite sign cancel, and "
    "its least value is no good fit.",
    "The printed ratios a_est/a_pom and the ranking of the models: they depend on the spool the authors "
    "measured. The ranking here is that of the truth stated above, which was chosen to be none of the "
    "four models.",
    "Figures 6 to 17: this page was made from the paper's text, without its figures. What the text says "
    "of them can be compared: resonances near 15 and 29 Hz, and more damping by the thicker oil.",
    "The regime of the measurements: amplitudes of the body are not printed. The one motion that the text "
    "gives, 60 Hz with a full stroke of 9 mm and a mean speed above 0.5 m/s, is the second regime below.",
    "Table 7 from tables 3 to 6: the mean of model 2 agrees with its four entries; for model 1 the four "
    "entries average 6.21e7 where 6.27e7 is printed.",
    "The viscosities at 20 deg C: the printed ones are what these oils have at about 40 deg C. They are "
    "used as printed.",
)
