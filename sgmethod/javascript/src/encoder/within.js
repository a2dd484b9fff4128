// The largest file within a number of bytes.

/** Bisect for the last whole number whose file fits, between low, which counts as fitting, and high, which does not.
 * fileOf: promises the file of a number; near: ends the search when low and high are no further apart. Returns low and
 * its file, null if no file was seen to fit. */
export async function largestWithin(fileOf, fits, low, high, near = 1) {
  let best = null;
  while (high - low > near) {
    const middle = (low + high) >> 1;
    const file = await fileOf(middle);
    if (fits(file)) [low, best] = [middle, file];
    else high = middle;
  }
  return [low, best];
}
