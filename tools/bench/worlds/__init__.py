"""The worlds that the benchmarks render, and the views of them."""
