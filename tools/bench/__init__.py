"""The benchmarks: what a sample, a batch, a message and a map cost, and how good colour is."""
