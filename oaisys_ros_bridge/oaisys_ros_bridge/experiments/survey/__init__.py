"""The paper's scene reconstruction."""
