"""The forward model and its derivatives: discretised bodies, rollouts, the torch op."""
