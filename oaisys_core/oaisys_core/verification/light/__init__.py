"""The audit of light: rendered patches under known light against closed forms."""
