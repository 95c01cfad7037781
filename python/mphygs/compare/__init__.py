"""Prediction beside measurement: residuals, noise, metrics, where and when, error budget."""
