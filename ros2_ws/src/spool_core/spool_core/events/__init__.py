"""Events of a valve: their fields, and the sentences that are composed from them in several languages."""
