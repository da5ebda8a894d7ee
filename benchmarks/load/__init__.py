"""A service of one's own under load: how quick it stays, and what it loses when its processes are killed."""
