"""The splatter's benchmark: its own scenes, a plain renderer to compare with, and the machine's limit."""
