"""Events: what begins and ends on a valve, how it is declared, and the condition behind it."""
