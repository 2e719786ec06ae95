// The scenario's plain data: values by their keys, and as overrides write them.

export type Table = Record<string, unknown>;

/** Lists of what is put in and taken out as a whole. */
export const LISTS = ["functions", "objects", "light.street_lamps", "spots", "probes"] as const;
export type List = (typeof LISTS)[number];

/** What is switched off: taken out, and kept to be put in again. */
export interface Off {
  list: List;
  name: string;
  table: Table;
  /** Checks on it, which would have nothing to look at. */
  checks: Table;
}

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
  return pathOf(key).reduce<unknown>((value, each) => (value as Table | null | undefined)?.[each], data);
}

/** Plain data with other values of keys; what has not changed is shared. */
export function patched<Data>(data: Data, changes: Iterable<readonly [key: string, value: unknown]>): Data {
  let made: unknown = data;
  for (const [key, value] of changes) made = withValue(made, pathOf(key), value);
  return made as Data;
}

function withValue(data: unknown, [first, ...rest]: readonly string[], value: unknown): unknown {
  if (first === undefined) return value;
  if (Array.isArray(data)) return data.map((each, k) => (String(k) === first ? withValue(each, rest, value) : each));
  if (typeof data !== "object" || data === null) return data;
  return { ...data, [first]: withValue((data as Table)[first], rest, value) };
}

function pathOf(key: string): string[] {
  return key.split(/\.|\[|\]\.?/).filter(Boolean);
}

/** A name that is not there yet: the given one, or that with a number behind it. */
export function unused(name: string, taken: readonly unknown[]): string {
  if (!taken.includes(name)) return name;
  const stem = name.replace(/_\d+$/, "");
  let number = 2;
  while (taken.includes(`${stem}_${number}`)) number++;
  return `${stem}_${number}`;
}
