from spool_stream.block import Block as Block
