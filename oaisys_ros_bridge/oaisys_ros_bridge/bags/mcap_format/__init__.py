"""The bytes of bags: records of MCAP files, definitions of messages, and what can be saved."""
