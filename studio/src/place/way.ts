// Ways whose points are clicked on the road one after the other: courses of objects, and paths of light.

import { BufferGeometry, Line, LineBasicMaterial, Vector3 } from "three";
import type { Placing } from "./placing.ts";
import { type Spot, spotAt } from "./spot.ts";

/** Let the user click a way, and tell its points once it is done. from: where it begins, in the world. */
export function clickWay(placing: Placing, what: string, from: Vector3 | null, done: (spots: Spot[]) => void): void {
  const spots: Spot[] = [];
  const line = new Line(new BufferGeometry(), new LineBasicMaterial({ color: 0xffffff, depthTest: false, transparent: true }));
  line.frustumCulled = false;
  line.renderOrder = 4;
  placing.view.overlay.add(line);
  const draw = () => {
    const points = [...(from ? [from] : []), ...spots.map(({ world }) => new Vector3(...world))];
    const T_local_world = placing.frame("world");
    line.geometry.dispose();
    line.geometry = new BufferGeometry().setFromPoints(points.map((point) => point.clone().applyMatrix4(T_local_world)));
    placing.view.redraw();
  };
  placing.await({
    say: `Click ${what} point by point. Enter or a click on the last point: done. Esc: leave it.`,
    click(x, y) {
      const spot = spotAt(placing, x, y);
      if (!spot) return;
      const last = spots.at(-1);
      if (last && new Vector3(...last.world).distanceTo(new Vector3(...spot.world)) < SAME_M) {
        this.done?.();
        return;
      }
      spots.push(spot);
      draw();
    },
    done() {
      placing.await(null);
      if (spots.length + (from ? 1 : 0) >= 2) done(spots);
    },
    ended() {
      placing.view.overlay.remove(line);
      line.geometry.dispose();
      line.material.dispose();
    },
  });
}

const SAME_M = 0.3;
