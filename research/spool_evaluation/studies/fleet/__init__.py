"""Study of fleets: drift over a year that no single bag shows, in fleets of known truth."""
