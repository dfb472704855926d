"""Plan of a measurement: what a record with these sensors and this excitation could tell."""
