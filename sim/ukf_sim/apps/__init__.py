"""Applications: studies that run a system's scenarios, and their tables and figures."""
