"""Which physical effect is missing: scores, trials, missing force, verdict."""
