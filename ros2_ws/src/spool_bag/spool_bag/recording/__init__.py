"""Recording: the node, its writer, snapshots, and recovery into a new bag."""
