"""Fit materials and effects to a capture: residuals, schedule, optimisers, resume."""
