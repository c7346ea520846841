"""The sub-command ``oaisys dataset``."""
