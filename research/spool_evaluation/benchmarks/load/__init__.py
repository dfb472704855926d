"""Load of benchmarks: sources of blocks, a peer that records, and what running processes cost."""
