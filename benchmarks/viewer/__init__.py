"""Our pictures beside those of an independent viewer."""
