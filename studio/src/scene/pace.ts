// Resolution of the canvas: where the processor draws in place of a graphics card, moving pictures are coarse and settle when they stop.

import type { WebGLRenderer } from "three";

const FINEST = 2; // device pixels per CSS pixel
const DRAFT = 0.5;
const SETTLED_MS = 400;

/** Whether the browser draws WebGL with the processor. */
export function drawsInSoftware(): boolean {
  const gl = document.createElement("canvas").getContext("webgl2");
  if (!gl) return false;
  const extension = gl.getExtension("WEBGL_debug_renderer_info");
  const name = gl.getParameter(extension ? extension.UNMASKED_RENDERER_WEBGL : gl.RENDERER);
  gl.getExtension("WEBGL_lose_context")?.loseContext();
  return /swiftshader|llvmpipe|softpipe|software|basic render/i.test(String(name));
}

export class Pace {
  private settling = 0;
  private ratio = 0;

  constructor(
    private readonly renderer: WebGLRenderer,
    private readonly software: boolean,
    private readonly draw: () => void,
  ) {
    this.finest();
  }

  /** Before a picture that something has changed. */
  moving(): void {
    if (!this.software) return;
    this.use(DRAFT);
    clearTimeout(this.settling);
    this.settling = window.setTimeout(() => {
      this.finest();
      this.draw();
    }, SETTLED_MS);
  }

  finest(): void {
    this.use(this.software ? 1 : Math.min(window.devicePixelRatio, FINEST));
  }

  dispose(): void {
    clearTimeout(this.settling);
  }

  private use(ratio: number): void {
    if (ratio === this.ratio) return;
    this.ratio = ratio;
    this.renderer.setPixelRatio(ratio);
  }
}
