"""The C application on an emulated Cortex-A9."""
