"""Elementary functions on the array: sequences of issue slots, bit for bit.

The modules build on each other in this order::

    primitives      what a lane can compute and write in one slot, and the unit 1/sqrt
    sequence        steps on temporaries, their builder, and their evaluation on arrays
    coefficients    polynomials and constants for the number formats
    quotients, trigonometric, inverse_trigonometric, exponential, selection
                    the functions
    functions       the functions by name

**Outside of a function's domain, or where an argument cannot be reduced well, the result is NaN,
never a wrong number.**
"""
