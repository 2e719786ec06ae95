// The light wanted, as false colours over the road or the wall.

import { DataTexture, DoubleSide, Matrix4, Mesh, MeshBasicMaterial, NearestFilter, PlaneGeometry, SRGBColorSpace } from "three";
import { colourOf } from "../scene/colour_map.ts";
import type { Raster } from "./raster.ts";

const ABOVE_M = 0.03; // the plane, so that it is seen
const OPACITY = 150; // of 255

export class WishPlane {
  readonly mesh: Mesh;
  readonly #pixels: Uint8Array;
  readonly #texture: DataTexture;

  constructor(readonly raster: Raster) {
    this.#pixels = new Uint8Array(4 * raster.rows * raster.cols);
    this.#texture = new DataTexture(this.#pixels, raster.cols, raster.rows);
    this.#texture.colorSpace = SRGBColorSpace;
    this.#texture.magFilter = this.#texture.minFilter = NearestFilter;
    const geometry = new PlaneGeometry(1, 1); // its u runs along y, its v along x
    const material = new MeshBasicMaterial({ map: this.#texture, transparent: true, depthWrite: false, side: DoubleSide });
    this.mesh = new Mesh(geometry, material);
    this.mesh.matrixAutoUpdate = this.mesh.frustumCulled = false;
    this.mesh.renderOrder = 1;
  }

  /** Lie on its plane, whose pose in the frame that it is shown in is given. */
  place(T_shown_plane: Matrix4): void {
    const [least_x, most_x, least_y, most_y] = this.raster.box_m;
    const centre = [(least_x + most_x) / 2, (least_y + most_y) / 2];
    const T = new Matrix4().set(0, most_x - least_x, 0, centre[0], most_y - least_y, 0, 0, centre[1], 0, 0, 1, ABOVE_M, 0, 0, 0, 1);
    this.mesh.matrix.multiplyMatrices(T_shown_plane, T);
    this.mesh.matrixWorldNeedsUpdate = true;
  }

  /** Show what the raster has now. */
  update(): void {
    const { lx, painted } = this.raster;
    for (let k = 0; k < lx.length; k++) {
      const [r, g, b] = colourOf(lx[k]);
      this.#pixels.set([r, g, b, painted[k] ? OPACITY : 0], 4 * k);
    }
    this.#texture.needsUpdate = true;
  }

  dispose(): void {
    this.mesh.removeFromParent();
    this.mesh.geometry.dispose();
    (this.mesh.material as MeshBasicMaterial).dispose();
    this.#texture.dispose();
  }
}
