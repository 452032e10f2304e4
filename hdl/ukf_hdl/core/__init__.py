"""The core: bus front end, control, buffer, and the array of processing elements."""
