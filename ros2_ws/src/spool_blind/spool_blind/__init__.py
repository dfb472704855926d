"""Records in which something is hidden, made by a simulator that shares nothing with the one that ships."""
