// Everything in the scenario's model that has a place.

import type { Model } from "../protocol.ts";
import { functionThings } from "./functions.ts";
import { objectThings } from "./objects.ts";
import type { Standing, Thing } from "./thing.ts";
import { worldThings } from "./world.ts";

/** All things of a model. told: the model that the scene shows, of which `model` may already be ahead. */
export function thingsOf(model: Model, told: Model, standing: Standing): Thing[] {
  return [...functionThings(model), ...objectThings(model, told, standing), ...worldThings(model)];
}
