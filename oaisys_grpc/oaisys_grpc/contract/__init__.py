"""The contract's messages and the core's types, in pairs of conversions; errors; shared memory."""
