"""The recipe that trains the tiny preset: procedural scenes, a differentiable splatter and the loop around them."""
