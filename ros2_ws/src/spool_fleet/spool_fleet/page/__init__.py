"""Page of the fleet, made from its tables."""
