"""What is kept: recorder, reader, import and export."""
