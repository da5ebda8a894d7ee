"""What a scene keeps, costs and loses: by leaving Gaussians out, and by the format of its file."""
