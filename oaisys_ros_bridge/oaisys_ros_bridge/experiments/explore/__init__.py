"""The paper's active view planning."""
