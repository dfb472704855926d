"""Blind test records: an effect is hidden by a simulator that shares nothing with the one that ships."""
