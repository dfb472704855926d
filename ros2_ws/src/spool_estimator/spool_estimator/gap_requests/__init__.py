"""Model-gap requests: when the live residual grows, and its analysis in a process of its own."""
