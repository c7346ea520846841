"""Plants that grow by rules: stems that branch, and leaves, needles and flowers on them."""
