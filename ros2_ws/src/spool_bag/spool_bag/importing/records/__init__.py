"""Records: choice of channels, time base, alignment of two clocks, bags."""
