// What is drawn of many steps: of each stretch its least and its largest value, so that no peak is lost.

export interface Stretch {
  first: number;
  end: number;
  /** Steps that share two points. */
  size: number;
}

/** How steps `first` to `end - 1` are drawn with at most about `most` points. */
export function stretch(first: number, end: number, most: number): Stretch {
  const steps = Math.max(0, end - first);
  return { first, end, size: steps <= most ? 1 : Math.ceil((2 * steps) / most) };
}

/** Steps at which there are points. */
export function places({ first, end, size }: Stretch): number[] {
  const found: number[] = [];
  if (size === 1) for (let step = first; step < end; step++) found.push(step);
  else for (let step = first; step < end; step += size) found.push(step, Math.min(step + size / 2, end - 1));
  return found;
}

/** Values at these points, null where there is none. */
export function thinned(at: (step: number) => number, { first, end, size }: Stretch): (number | null)[] {
  const found: (number | null)[] = [];
  const plain = (value: number) => (Number.isFinite(value) ? value : null);
  for (let start = first; start < end; start += size) {
    if (size === 1) {
      found.push(plain(at(start)));
      continue;
    }
    let [low, high, lowest, highest] = [Number.POSITIVE_INFINITY, Number.NEGATIVE_INFINITY, start, start];
    for (let step = start; step < Math.min(start + size, end); step++) {
      const value = at(step);
      if (value < low) [low, lowest] = [value, step];
      if (value > high) [high, highest] = [value, step];
    }
    found.push(...(lowest < highest ? [plain(low), plain(high)] : [plain(high), plain(low)]));
  }
  return found;
}
