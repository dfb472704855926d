"""Recording: the node, its writer and snapshots."""
