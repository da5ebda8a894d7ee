"""gapmes.service.scenes: the store of scenes: folders, their index, limits, a cache in memory."""
