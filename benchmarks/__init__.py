"""Benchmarks of speed, side by side in one run, and of the cost of settings; neither part of the package nor tests."""
