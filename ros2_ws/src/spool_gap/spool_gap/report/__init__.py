"""What a result says: where the gap sits, sentences, JSON."""
