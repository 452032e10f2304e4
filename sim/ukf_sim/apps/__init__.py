"""Applications: running the catalogue, judging it, and drawing figures."""
