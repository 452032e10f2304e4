"""Command line, estimates, and evaluations of cores."""
