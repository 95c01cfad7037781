"""What we believe: materials, effects and their parameters, with bounds, units and priors."""
