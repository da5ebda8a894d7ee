"""Published weights of DINOv2 and Depth-Anything-V2, loaded strictly from the layouts that they are published in."""
