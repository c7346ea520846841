"""How programs end: at a signal or with their owner, leaving nothing behind but last words."""
