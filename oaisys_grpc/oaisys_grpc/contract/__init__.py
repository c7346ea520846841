"""The contract's messages and the simulator's types, in pairs of conversions; errors; shared memory."""
