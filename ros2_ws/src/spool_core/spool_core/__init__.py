"""Sample streams: blocks, their judgement, the error that a user can put right."""
