"""DepthSplat's network (its published layout of tensors), so that its public checkpoints can be exported and served."""
