// Functions by the names by which formulas know them.

export const { ceil, exp, floor, fround, max, min, sqrt } = Math;
