"""File formats of Gaussians: a module for each, shared code of readers and writers, and a registry."""
