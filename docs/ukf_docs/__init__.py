"""Documentation: what of it is generated, and how the site is built."""
