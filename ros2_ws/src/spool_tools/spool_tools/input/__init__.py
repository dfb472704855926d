"""Input of the commands: records, valve files, excitations."""
