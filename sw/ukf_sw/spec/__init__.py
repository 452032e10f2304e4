"""What a core is: parameters, number formats, registers, memory map. All else derives from it."""
