"""The command line of the suite and its reports."""
