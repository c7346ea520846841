"""Configuration files of the original OAISYS simulator, turned into ours."""
