// What the scenario model's schema says of a key: its form, range, default, and meaning.

/** JSON Schema, as far as the model's has it. */
export interface Schema {
  $ref?: string;
  $defs?: Record<string, Schema>;
  anyOf?: Schema[];
  oneOf?: Schema[];
  type?: string;
  const?: unknown;
  enum?: (string | number)[];
  properties?: Record<string, Schema>;
  patternProperties?: Record<string, Schema>;
  additionalProperties?: Schema | boolean;
  propertyNames?: Schema;
  items?: Schema;
  prefixItems?: Schema[];
  minimum?: number;
  maximum?: number;
  exclusiveMinimum?: number;
  exclusiveMaximum?: number;
  default?: unknown;
  examples?: unknown[];
  description?: string;
}

export interface Range {
  least: number;
  most: number;
  /** Whether least itself is too small. */
  open: boolean;
  whole: boolean;
}

export type Form =
  | { is: "number"; range: Range }
  | { is: "choice"; options: (string | number)[] }
  | { is: "boolean" | "text" | "other" }
  | { is: "numbers"; ranges: Range[] }
  | { is: "flags"; options: (string | number)[] }
  | { is: "words"; whole: boolean }
  | { is: "table"; keys: Record<string, Schema> }
  | { is: "variants"; tag: string; of: Map<string, Schema> }
  | { is: "list"; item: Schema }
  | { is: "mapping"; item: Schema; names: string[] | null };

export interface Field {
  form: Form;
  description: string;
  /** undefined: it has none, so that it has to be given. */
  default: unknown;
  /** Whether it may be left out, which is null in the model. */
  optional: boolean;
}

const ONE_OF_SEVERAL = ["track", "at_least"]; // keys of which the model wants this or another, whatever their defaults

export class Schemas {
  constructor(readonly root: Schema) {}

  /** What is said of a key. fallback: its default in the default of its table, if that has one. */
  field(schema: Schema, fallback: unknown = schema.default): Field {
    const plain = schema.anyOf?.find(({ type }) => type !== "null");
    const inner = this.#of(plain ?? schema);
    const optional = plain !== undefined && (fallback === null || fallback === undefined);
    return { form: this.#form(inner), description: schema.description ?? inner.description ?? "", default: fallback, optional };
  }

  /** A value for what has none yet: what has to be given, and as much as tells it from an empty table. */
  fresh(schema: Schema, name = "", variant?: string): unknown {
    const field = this.field(schema);
    const { form } = field;
    if (form.is === "variants") {
      const tag = variant ?? [...form.of.keys()][0];
      return { [form.tag]: tag, ...this.#required(form.of.get(tag)!, name) };
    }
    if (form.is === "table") {
      const needed = this.#required(this.#of(schema.anyOf?.[0] ?? schema), name);
      if (Object.keys(needed).length > 0) return needed;
      const [key, value] = Object.entries(form.keys).find(([, each]) => typeof each.default === "number") ?? [];
      return key ? { [key]: value?.default } : {};
    }
    if (schema.examples) return schema.examples[0];
    if (field.default !== undefined && field.default !== null) return field.default;
    if (form.is === "number") return within(0, form.range);
    if (form.is === "numbers") return form.ranges.map((range) => within(0, range));
    if (form.is === "choice") return form.options[0];
    return form.is === "boolean" ? false : form.is === "text" ? name : [];
  }

  #required(schema: Schema, name: string): Record<string, unknown> {
    const all = Object.entries(schema.properties ?? {});
    const needed = all.filter(([key, each]) => ONE_OF_SEVERAL.includes(key) || (!("default" in each) && each.const === undefined));
    return Object.fromEntries(needed.map(([key, each]) => [key, key === "name" && name ? name : this.#first(each, name)]));
  }

  /** A value that is more than an empty list. */
  #first(schema: Schema, name: string): unknown {
    const { form } = this.field(schema);
    return form.is === "list" && !schema.examples ? [this.fresh(form.item)] : this.fresh(schema, name);
  }

  #of(schema: Schema): Schema {
    const found = schema.$ref && this.root.$defs?.[schema.$ref.slice("#/$defs/".length)];
    return found || schema;
  }

  #form(schema: Schema): Form {
    if (schema.oneOf) return this.#variants(schema.oneOf);
    if (schema.enum) return { is: "choice", options: schema.enum };
    switch (schema.type) {
      case "number":
      case "integer":
        return { is: "number", range: rangeOf(schema) };
      case "boolean":
        return { is: "boolean" };
      case "string":
        return { is: "text" };
      case "array":
        return this.#array(schema);
      case "object":
        return this.#object(schema);
      default:
        return { is: "other" };
    }
  }

  /** Variants of a table. Those of the user's own code, which have no fixed name, cannot be chosen. */
  #variants(all: Schema[]): Form {
    const of = new Map<string, Schema>();
    let tag = "kind";
    for (const each of all.map((one) => this.#of(one))) {
      const [key, found] = Object.entries(each.properties ?? {}).find(([, one]) => one.const !== undefined) ?? [];
      if (key === undefined) continue;
      tag = key;
      of.set(String(found?.const), each);
    }
    return { is: "variants", tag, of };
  }

  #array(schema: Schema): Form {
    if (schema.prefixItems) return { is: "numbers", ranges: schema.prefixItems.map(rangeOf) };
    const item = schema.items ?? {};
    if (item.enum) return { is: "flags", options: item.enum };
    if (item.type === "string" || item.type === "integer") return { is: "words", whole: item.type === "integer" };
    return { is: "list", item };
  }

  #object(schema: Schema): Form {
    if (schema.properties) return { is: "table", keys: schema.properties };
    const item = Object.values(schema.patternProperties ?? {})[0] ?? schema.additionalProperties;
    if (typeof item !== "object") return { is: "other" };
    return { is: "mapping", item, names: (schema.propertyNames?.enum as string[] | undefined) ?? null };
  }
}

function rangeOf(schema: Schema): Range {
  const least = schema.exclusiveMinimum ?? schema.minimum ?? Number.NEGATIVE_INFINITY;
  const most = schema.exclusiveMaximum ?? schema.maximum ?? Number.POSITIVE_INFINITY;
  return { least, most, open: schema.exclusiveMinimum !== undefined, whole: schema.type === "integer" };
}

/** The nearest value that a range has; where its lower end is open, one a little above. */
export function within(value: number, { least, most, open, whole }: Range): number {
  const lower = open && Number.isFinite(least) ? least + (whole ? 1 : Math.min(1, (Math.min(most, least + 100) - least) / 100)) : least;
  return Math.min(most, Math.max(lower, value));
}

/** The keys of a table, each with its default: that in the table's default, if this has one. Constants, which tell variants, are left out. */
export function keysOf(keys: Record<string, Schema>, fallback: unknown): [name: string, schema: Schema, fallback: unknown][] {
  const defaults = (typeof fallback === "object" ? fallback : null) as Record<string, unknown> | null;
  return Object.entries(keys)
    .filter(([, each]) => each.const === undefined)
    .map(([name, each]) => [name, each, defaults && name in defaults ? defaults[name] : each.default]);
}

/** A default, if it is of the same variant as a value. */
export function sameVariant(fallback: unknown, value: unknown, tag: string): unknown {
  const [one, other] = [fallback, value] as ({ [tag: string]: unknown } | null)[];
  return one?.[tag] === other?.[tag] ? fallback : null;
}

/** Whether two values of plain data are the same. */
export function same(one: unknown, other: unknown): boolean {
  if (typeof one !== "object" || typeof other !== "object" || one === null || other === null) return Object.is(one, other);
  const keys = Object.keys(one);
  return (
    keys.length === Object.keys(other).length &&
    keys.every((key) => key in other && same((one as Record<string, unknown>)[key], (other as Record<string, unknown>)[key]))
  );
}
