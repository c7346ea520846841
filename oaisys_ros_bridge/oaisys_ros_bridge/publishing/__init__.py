"""From samples to messages on topics."""
