"""Set-up behind `./spool`: environment, build, hand-over. Standard library only."""
