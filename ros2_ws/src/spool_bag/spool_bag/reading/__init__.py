"""Reading and recovering bags."""
