"""The driver of a core, and the buses to reach one."""
