"""How the suite is started."""
