"""Applications: running the catalogue and the studies, judging them, and drawing figures."""
