// Meshes of the run, and which of them are there in a step.

import {
  BufferAttribute,
  BufferGeometry,
  ClampToEdgeWrapping,
  DataTexture,
  Group,
  LinearFilter,
  LinearMipmapLinearFilter,
  Mesh,
  type Object3D,
  type RawShaderMaterial,
  RedFormat,
  type Texture,
} from "three";
import type { Arrays, Picture } from "../arrays.ts";
import type { MeshesMessage, MeshHead, StepMessage } from "../protocol.ts";
import type { LocalFrame } from "./frames.ts";
import type { SurfaceMaterials } from "./uniforms.ts";

/** Layer of all that throws shadows; the default layer has markers as well. */
export const SOLID = 1;
const FORGOTTEN_AFTER = 200; // steps without it, a mesh leaves the graphics memory until it is shown again

interface Shape {
  object: string;
  road: boolean;
  geometry: BufferGeometry;
  material: RawShaderMaterial;
  texture: Texture | null;
  meshes: Mesh[];
  used: number;
  shown: number;
  loaded: boolean;
}

export class Bodies {
  readonly group = new Group();
  private readonly shapes = new Map<number, Shape>();
  private shows = 0;

  constructor(private readonly materials: SurfaceMaterials) {}

  add(message: MeshesMessage, arrays: Arrays): void {
    for (const head of message.meshes) {
      this.forget(head.id);
      const shape = this.shape(head, arrays);
      if (shape) this.shapes.set(head.id, shape);
    }
  }

  show(bodies: StepMessage["bodies"], frame: LocalFrame): void {
    this.shows += 1;
    for (const shape of this.shapes.values()) shape.used = 0;
    for (const body of bodies) {
      const shape = this.shapes.get(body.mesh);
      if (!shape) continue;
      const mesh = shape.meshes[shape.used] ?? this.another(shape);
      shape.used += 1;
      shape.shown = this.shows;
      shape.loaded = true;
      mesh.visible = true;
      mesh.matrix.copy(frame.pose(body.T_world_body));
      mesh.matrixWorldNeedsUpdate = true;
    }
    for (const shape of this.shapes.values()) {
      for (const mesh of shape.meshes.slice(shape.used)) mesh.visible = false;
      if (shape.loaded && this.shows - shape.shown > FORGOTTEN_AFTER) {
        shape.geometry.dispose();
        shape.texture?.dispose();
        shape.loaded = false;
      }
    }
  }

  /** The mesh of an object that is there now. */
  find(object: string): Mesh | null {
    const fits = (each: Object3D): each is Mesh => each instanceof Mesh && each.visible && each.name === object && !each.userData.road;
    return this.group.children.find(fits) ?? null;
  }

  clear(): void {
    for (const id of [...this.shapes.keys()]) this.forget(id);
  }

  private shape(head: MeshHead, arrays: Arrays): Shape | null {
    const of = (name: string) => arrays.get(`${head.id}.${name}`);
    const [vertices, normals, faces] = [of("vertices")?.values, of("normals")?.values, of("faces")?.values];
    if (!vertices || !normals || !faces) return null;
    const geometry = new BufferGeometry();
    geometry.setAttribute("position", new BufferAttribute(vertices, 3));
    geometry.setAttribute("normal", new BufferAttribute(normals, 3));
    geometry.setIndex(new BufferAttribute(faces, 1));
    const picture = of("texture");
    const texture = picture && head.box ? albedoTexture(picture) : null;
    const material =
      texture && head.box ? this.materials.ofTexture(head.two_sided, texture, head.box) : this.materials.ofVertices(head.two_sided);
    if (!texture) geometry.setAttribute("albedo", new BufferAttribute(of("albedo")?.values ?? grey(vertices.length / 3), 1, true));
    return { object: head.object, road: head.kind === "road", geometry, material, texture, meshes: [], used: 0, shown: 0, loaded: false };
  }

  private another(shape: Shape): Mesh {
    const mesh = new Mesh(shape.geometry, shape.material);
    mesh.name = shape.object;
    mesh.userData.road = shape.road;
    mesh.matrixAutoUpdate = false;
    mesh.layers.enable(SOLID);
    shape.meshes.push(mesh);
    this.group.add(mesh);
    return mesh;
  }

  private forget(id: number): void {
    const shape = this.shapes.get(id);
    if (!shape) return;
    this.group.remove(...shape.meshes);
    shape.geometry.dispose();
    if (shape.texture) {
      shape.texture.dispose();
      shape.material.dispose();
    }
    this.shapes.delete(id);
  }
}

function grey(count: number): Uint8Array {
  return new Uint8Array(count).fill(128);
}

function albedoTexture({ shape, values }: Picture): Texture | null {
  const [height = 1, width = 1] = shape;
  if (!(values instanceof Uint8Array)) return null;
  const texture = new DataTexture(values, width, height, RedFormat);
  texture.flipY = false;
  texture.wrapS = texture.wrapT = ClampToEdgeWrapping;
  texture.magFilter = LinearFilter;
  texture.minFilter = LinearMipmapLinearFilter;
  texture.generateMipmaps = true;
  texture.anisotropy = 4;
  texture.needsUpdate = true;
  return texture;
}
