"""Jobs of the topic ``dataset``."""
