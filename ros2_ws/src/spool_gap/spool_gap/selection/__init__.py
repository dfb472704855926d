"""Selection of the effects that the data name."""
