"""Text for people: sentences, suggestions, printable names."""
