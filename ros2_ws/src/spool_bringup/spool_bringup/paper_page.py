"""What `./spool paper` can and cannot say."""

from __future__ import annotations

#: What the comparison can tell, and what only the authors' measurements could.
CAN: tuple[str, ...] = (
    "The undamped natural frequencies, 15.15 and 28.68 Hz, and the viscous coefficients of equation "
    "(12), 8.20 and 2.65 N s/m: they follow from table 2.",
    "What each of the four equations does at 10 to 100 Hz with given parameters, the printed ones included.",
    "Which parameters a fit by (33) can tell apart. In model 1 only the product k_t (d_k0 - a_k0) acts, "
    "so the three columns of table 3 are one number; in model 3 with the drag of (12) K_V only changes "
    "the viscous coefficient to (1 - K_V) of it.",
    "Why model 4 beats models 1 and 3 in the printed tables although both contain it: h is fitted in "
    "model 4 only. With h fitted in all of them the larger models are never worse (last table).",
    "That the values of table 4 lock the spool (below).",
)
CANNOT: tuple[str, ...] = (
    "The printed objective values: they depend on the measured waveforms, their length and sigma, none "
    "of which is printed; (33) as printed is not squared, so that errors of opposite sign cancel, and "
    "its least value is no good fit.",
    "The printed ratios a_est/a_pom and the ranking of the models: they depend on the spool the authors "
    "measured. The ranking here is that of the truth stated above, which was chosen to be none of the "
    "four models.",
    "Figures 6 to 11 as numbers: neither the amplitudes of the shaker nor those of the spool are "
    "printed. Their shape, resonances and the influence of spring and oil can be compared.",
    "Table 7 from tables 3 to 6: the mean of model 2 agrees with its four entries; for model 1 the four "
    "entries average 6.21e7 where 6.27e7 is printed.",
    "The viscosities at 20 deg C: the printed ones are what these oils have at about 40 deg C. They are "
    "used as printed.",
)
