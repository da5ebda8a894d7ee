"""A service under load: how fast it stays, and what it loses when its processes are killed."""
