"""Grounds made by code: noise, presets and blend masks."""
