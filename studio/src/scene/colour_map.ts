// The false-colour map of illuminance: viridis, which is perceptually uniform and safe for colour-blind readers, over three decades.

export const DECADES: readonly [number, number] = [-1, 2];
export const ISOLUX_LX = [0.5, 1, 2, 5, 10, 20, 50] as const;

const STOPS = ["440154", "472d7b", "3b528b", "2c728e", "21918c", "28ae80", "5ec962", "addc30", "fde725"] as const;

/** As a CSS gradient from left to right. */
export const GRADIENT = `linear-gradient(to right, ${STOPS.map((stop) => `#${stop}`).join(", ")})`;

/** Share 0..1 of the map at an illuminance in lx. */
export function share(lx: number): number {
  return (Math.log10(lx) - DECADES[0]) / (DECADES[1] - DECADES[0]);
}

/** Colour 0..255 of an illuminance in lx. */
export function colourOf(lx: number): [number, number, number] {
  const at = Math.min(Math.max(share(Math.max(lx, 1e-9)), 0), 1) * (STOPS.length - 1);
  const below = Math.min(Math.floor(at), STOPS.length - 2);
  const [low, high] = [STOPS[below], STOPS[below + 1]].map((stop) => parseInt(stop, 16));
  const channel = (shift: number) => {
    const [a, b] = [(low >> shift) & 255, (high >> shift) & 255];
    return Math.round(a + (at - below) * (b - a));
  };
  return [channel(16), channel(8), channel(0)];
}

function channels(stop: string): string {
  const value = parseInt(stop, 16);
  return [value >> 16, (value >> 8) & 255, value & 255].map((channel) => (channel / 255).toFixed(4)).join(", ");
}

function float(value: number): string {
  return Number.isInteger(value) ? `${value}.0` : `${value}`;
}

export const COLOUR_MAP_GLSL = /* glsl */ `
const vec3 STOPS[${STOPS.length}] = vec3[${STOPS.length}](${STOPS.map((stop) => `vec3(${channels(stop)})`).join(", ")});
const float ISOLUX[${ISOLUX_LX.length}] = float[${ISOLUX_LX.length}](${ISOLUX_LX.map((lx) => float(Math.log10(lx))).join(", ")});

/** sRGB of log10 of an illuminance in lx. */
vec3 false_colour(float log_lx) {
  float at = clamp((log_lx - ${float(DECADES[0])}) / ${float(DECADES[1] - DECADES[0])}, 0.0, 1.0) * ${STOPS.length - 1}.0;
  int below = min(int(at), ${STOPS.length - 2});
  return mix(STOPS[below], STOPS[below + 1], at - float(below));
}

/** Coverage of a pixel by isolux lines. Call it where all pixels of a quad do, since it takes derivatives. */
float isolux(float log_lx) {
  float per_pixel = clamp(fwidth(log_lx), 1e-6, 0.12); // at most, lest borders of shadows have lines of levels that they do not reach
  float line = 0.0;
  for (int i = 0; i < ${ISOLUX_LX.length}; i++) {
    line = max(line, 1.0 - smoothstep(0.4, 1.3, abs(log_lx - ISOLUX[i]) / per_pixel));
  }
  return line;
}
`;
