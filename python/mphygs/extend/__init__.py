"""Add an effect and refit; the whole loop from the first fit to the explained error."""
