"""Hardware of the UKF core, in Amaranth."""
