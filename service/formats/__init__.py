"""The file formats of Gaussians: one file for each, what their readers and writers share, and the registry of them."""
