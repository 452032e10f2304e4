"""Systems to estimate: models, simulated or recorded data, and scenarios made of them."""
