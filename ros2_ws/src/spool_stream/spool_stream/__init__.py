"""What every consumer of samples shares: blocks, their judgement, the error that a user can put right."""
