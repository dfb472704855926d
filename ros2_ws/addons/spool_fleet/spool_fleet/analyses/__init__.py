"""Analyses of one bag; each module declares one as ``ANALYSIS``."""
