"""From messages on topics back to whole samples, and an account of what is missing."""
