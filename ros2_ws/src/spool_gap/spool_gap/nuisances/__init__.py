"""Nuisances of the measuring chain: found, corrected and told, never taken for mechanics."""
