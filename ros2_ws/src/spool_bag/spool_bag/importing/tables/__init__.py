"""Tables of a file: channels in groups, each on one clock."""
