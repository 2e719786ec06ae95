// Things in the scene: they are chosen, moved, added and removed there.

import type { ScenesPanel } from "../scenes/panel.ts";
import type { Session } from "../session.ts";
import type { Studio } from "../state.ts";
import { addMenu } from "./add.ts";
import { deeds } from "./deeds.ts";
import { bindPlaceKeys } from "./keys.ts";
import { placePanel } from "./panel.ts";
import { Placing } from "./placing.ts";
import { bindPointer } from "./pointer.ts";

/** In the scene of the first run; null where the browser draws none. */
export function placeThings(store: Studio, session: Session, scenes: ScenesPanel, toast: (sentence: string) => void): Placing | null {
  const [view] = scenes.views;
  if (!view) return null;
  const placing = new Placing(store, session, view, toast);
  const done = deeds(placing);
  placePanel(placing, addMenu(placing, toast), done, scenes.bar, scenes.body);
  bindPointer(placing);
  bindPlaceKeys(placing, done);
  placing.refresh();
  return placing;
}
