"""Pictures of Gaussians and how like a photograph they are: projection, splatting, losses, metrics."""
