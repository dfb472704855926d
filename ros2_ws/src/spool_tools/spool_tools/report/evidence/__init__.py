"""Evidence: pictures that let an expert check what a report says, each with how to read it."""
