"""Reconstructions as jobs: described on disk, queued in the store's database, computed by whichever process is free."""
