"""The module of things that stand on the ground: drawn at a batch, edited at samples."""
