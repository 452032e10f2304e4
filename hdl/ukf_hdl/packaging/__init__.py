"""What a core needs around it: scripts for Vivado, constraints, device tree."""
