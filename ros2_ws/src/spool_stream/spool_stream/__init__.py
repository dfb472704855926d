"""What every consumer of samples shares: blocks, their judgement, the error a user can mend."""
