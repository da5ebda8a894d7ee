"""Reconstructions as jobs: inputs on disk, a queue in the store's database, computed by any process of the store."""
