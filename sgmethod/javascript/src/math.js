// Math's functions by the names that formulas have for them.

export const { ceil, exp, floor, fround, max, min, sqrt } = Math;
