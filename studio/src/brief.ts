/** A number in few characters. */
export function brief(value: number): string {
  if (!Number.isFinite(value)) return "-";
  const size = Math.abs(value);
  if (size !== 0 && (size < 1e-3 || size >= 1e6)) return value.toExponential(1);
  if (Number.isInteger(value) && size < 1e6) return String(value);
  return size >= 1000 ? value.toFixed(0) : String(+value.toPrecision(3));
}
