"""gapmes.service.scenes: the scene store: a folder per scene, an SQLite index, eviction, and a cache in memory."""
