"""The filter wholly in software, for honest speed-ups: built, run, counted, costed."""
