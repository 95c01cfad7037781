"""Faults of a measurement that its tracks show before anything is fitted, one file each."""
