"""Serialised form of the messages that are read in bulk."""
