"""The report of error against run time: every setting that a user has, timed and compared."""
