"""A problem of one's own with models in Python and in C: angles, two sensors, uneven intervals."""
