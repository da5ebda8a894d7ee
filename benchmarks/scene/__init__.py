"""Quality and cost of a scene: when Gaussians are left out, in each file format, and at each level of detail."""
