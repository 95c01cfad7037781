"""Faults of the measurement, one file each: a file added here is a fault added everywhere."""
