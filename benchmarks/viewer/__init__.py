"""Our pictures against those of an independent viewer."""
