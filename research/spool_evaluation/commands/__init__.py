"""Commands of the evaluation, one module each."""
