// Values as overrides write them.

/** Plain data as a TOML value. Keys without a value, null, are left out, as TOML has none. */
export function toml(value: unknown): string {
  if (Array.isArray(value)) return `[${value.map(toml).join(", ")}]`;
  if (typeof value === "object" && value !== null) {
    const given = Object.entries(value).filter(([, each]) => each !== null && each !== undefined);
    return `{${given.map(([key, each]) => `${/^[\w-]+$/.test(key) ? key : JSON.stringify(key)} = ${toml(each)}`).join(", ")}}`;
  }
  return typeof value === "string" ? JSON.stringify(value).replaceAll("\x7f", "\\u007f") : String(value);
}

/** An override that gives a key a value; null and undefined leave it out. */
export function override(key: string, value: unknown): string {
  return `${key}=${value === null || value === undefined ? "{}" : toml(value)}`;
}

/** Key of a part of a table, or of an item of a list by its number. */
export function part(key: string, of: string | number): string {
  if (typeof of === "number") return `${key}[${of}]`;
  return key ? `${key}.${of}` : of;
}

/** Value of a key in plain data, undefined where there is none. */
export function valueAt(data: unknown, key: string): unknown {
  const parts = key.split(/\.|\[|\]\.?/).filter(Boolean);
  return parts.reduce<unknown>((value, each) => (value as Record<string, unknown> | null | undefined)?.[each], data);
}
