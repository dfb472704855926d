"""Model-gap requests: when the live residual grows, and its analysis beside the stream."""
