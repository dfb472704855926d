"""Force records: the missing force by regression at the measured motion."""
