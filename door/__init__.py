"""What stands behind `./spool`: sets the project up, builds it, and hands over. Standard library only."""
