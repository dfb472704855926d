from spool_stream.block_gate import *  # noqa: F403
