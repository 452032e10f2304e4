"""Estimation problems with their data, and judging what a filter makes of them."""
