"""Tables of samples: names of their columns, export."""
