"""Import of any logger's file: formats, units, clocks."""
