"""What a core will take, before it is built: cycles, resources, longest path."""
