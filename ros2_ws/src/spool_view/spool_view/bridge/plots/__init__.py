"""Topics of single numbers, which live plotters draw directly."""
