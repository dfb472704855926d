"""Text of a CSV file: pieces, dialect, cells."""
