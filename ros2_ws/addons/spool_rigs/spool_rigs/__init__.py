"""Records of a test rig: the force that is missing, by regression at the measured motion."""
