"""The sections of the configuration: keys, bounds and defaults, each stated once."""
