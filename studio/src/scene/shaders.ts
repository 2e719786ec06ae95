// GLSL of the light: the same functions colour surfaces, fill fog and answer probes.

import { COLOUR_MAP_GLSL } from "./colour_map.ts";

export const MOST_MODULES = 12;
export const MOST_MAPS = 4;
export const MOST_LAMPS = 16;

const HEAD = /* glsl */ `
precision highp float;
precision highp int;
precision highp sampler2D;
`;

/**
 * Light of the modules, `E_v = I(y / x, z / x) cos / d^2`, as `reach` and `illuminance` of world/light/illumination.py have it.
 *
 * A shadow map holds depths, of which 1 / x along the map's axis is a linear function. A texel hides a point where its surface is closer
 * to the lamp and stands above the plane through the point: light that grazes the road passes over metres of it within one texel, so a
 * bias in depth would either leave acne there or lose the shadows of everything low.
 */
export const LIGHT = /* glsl */ `
uniform int module_count;
uniform mat4 module_pose[${MOST_MODULES}]; // T_module_local
uniform vec3 module_position[${MOST_MODULES}];
uniform vec4 module_borders[${MOST_MODULES}]; // left, right, bottom, top: tangents
uniform vec4 module_place[${MOST_MODULES}]; // in the atlas: first column, first row, columns, rows
uniform vec2 module_light[${MOST_MODULES}]; // cd of a texel's unit; number of the shadow map
uniform sampler2D light_atlas;
uniform float extinction_per_m;

uniform bool shadows;
uniform mat4 map_pose[${MOST_MAPS}]; // T_map_local
uniform vec4 map_borders[${MOST_MAPS}];
uniform vec4 map_place[${MOST_MAPS}]; // in the texture: first column, first row, columns, rows
uniform vec2 map_range; // 1 / nearest, 1 / farthest
uniform sampler2D shadow_maps;

const float NOTHING_HIDES = -1.0;
const float FLAT_M = 0.003;

/** Intensity in cd of a module towards a point in its own frame. */
float intensity(int k, vec3 q) {
  if (q.x <= 0.0) return 0.0;
  vec4 borders = module_borders[k];
  vec4 place = module_place[k];
  vec2 at = vec2(borders.x - q.y / q.x, borders.w - q.z / q.x) / vec2(borders.x - borders.y, borders.w - borders.z) * place.zw;
  if (any(lessThan(at, vec2(0.0))) || any(greaterThan(at, place.zw))) return 0.0;
  at = clamp(at, vec2(0.5), place.zw - 0.5);
  return module_light[k].x * textureLod(light_atlas, (place.xy + at) / vec2(textureSize(light_atlas, 0)), 0.0).r;
}

/** 1 / x of what a texel of a shadow map sees; NOTHING_HIDES where it sees nothing. */
float nearest(int map, ivec2 texel) {
  float depth = texelFetch(shadow_maps, texel, 0).r;
  return depth >= 1.0 ? NOTHING_HIDES : mix(map_range.x, map_range.y, depth);
}

/** Share of a map's four texels around a point that leave it lit; plane: normal of the surface there, from which lower things than least_m throw no shadows. */
float unshadowed(int map, vec3 p, vec3 plane, float least_m) {
  vec3 q = (map_pose[map] * vec4(p, 1.0)).xyz;
  vec3 n = mat3(map_pose[map]) * plane;
  float away = -dot(n, q); // of the lamp from the plane
  if (away <= 0.0) return 0.0;
  if (q.x * map_range.x <= 1.0) return 1.0;
  vec4 borders = map_borders[map];
  vec4 place = map_place[map];
  vec2 size = vec2(borders.x - borders.y, borders.w - borders.z);
  vec2 at = vec2(borders.x - q.y / q.x, q.z / q.x - borders.z) / size * place.zw - 0.5;
  if (any(lessThan(at, vec2(-0.5))) || any(greaterThan(at, place.zw - 0.5))) return 1.0;
  vec2 first = floor(at);
  vec2 part = at - first;
  float footprint = 2.0 * q.x * q.x * (size.y / place.w) / away; // of two texels, along the plane
  float lit = 0.0;
  for (int i = 0; i < 4; i++) {
    vec2 corner = vec2(i & 1, i >> 1);
    vec2 texel = clamp(first + corner, vec2(0.0), place.zw - 1.0);
    float hidden = 0.0;
    float inverse_x = nearest(map, ivec2(place.xy + texel));
    if (inverse_x * q.x > 1.0) {
      vec2 centre = (texel + 0.5) / place.zw;
      vec3 occluder = vec3(1.0, borders.x - centre.x * size.x, borders.z + centre.y * size.y) / inverse_x - q;
      float rough = 0.02 * min(length(occluder), footprint); // facets beside the point have other slopes
      hidden = dot(n, occluder) > least_m + rough ? 1.0 : 0.0;
    }
    vec2 weight = mix(1.0 - part, part, corner);
    lit += (1.0 - hidden) * weight.x * weight.y;
  }
  return lit;
}

/** Whether the nearest texel of a map leaves a point of the air lit. */
float unshadowed_air(int map, vec3 p) {
  vec3 q = (map_pose[map] * vec4(p, 1.0)).xyz;
  if (q.x * map_range.x <= 1.0) return 1.0;
  vec4 borders = map_borders[map];
  vec4 place = map_place[map];
  vec2 at = vec2(borders.x - q.y / q.x, q.z / q.x - borders.z) / vec2(borders.x - borders.y, borders.w - borders.z) * place.zw;
  if (any(lessThan(at, vec2(0.0))) || any(greaterThanEqual(at, place.zw))) return 1.0;
  return nearest(map, ivec2(place.xy + at)) * q.x > 1.0 ? 0.0 : 1.0;
}

/** Illuminance in lx by the lamps at a point; normal: what light is weighted by; plane, least_m: as of unshadowed. */
float lamps_lx(vec3 p, vec3 normal, vec3 plane, float least_m) {
  float by_map[${MOST_MAPS}] = float[${MOST_MAPS}](0.0, 0.0, 0.0, 0.0);
  for (int k = 0; k < module_count; k++) {
    vec3 away = module_position[k] - p;
    float facing = dot(normal, away);
    if (facing <= 0.0) continue;
    float cd = intensity(k, (module_pose[k] * vec4(p, 1.0)).xyz);
    if (cd <= 0.0) continue;
    float d2 = dot(away, away);
    float d = sqrt(d2);
    by_map[int(module_light[k].y)] += cd * facing / (d2 * d) * exp(-extinction_per_m * d);
  }
  float lx = 0.0;
  for (int map = 0; map < ${MOST_MAPS}; map++) {
    if (by_map[map] > 0.0) lx += by_map[map] * (shadows ? unshadowed(map, p, plane, least_m) : 1.0);
  }
  return lx;
}
`;

/** Light that is there without the lamps, without shadows, as world/light/ambient.py has it. */
const OTHER_LIGHT = /* glsl */ `
uniform float ambient_lx;
uniform int street_count;
uniform vec4 street_lamps[${MOST_LAMPS}]; // position; cd
uniform int spot_count;
uniform vec4 spot_position[${MOST_LAMPS}]; // position; cd
uniform vec3 spot_axis[${MOST_LAMPS}];
uniform vec2 spot_width[${MOST_LAMPS}]; // deg, across and up

float other_lx(vec3 p, vec3 normal) {
  float lx = ambient_lx * (1.0 + normal.z) / 2.0;
  for (int k = 0; k < street_count; k++) {
    vec3 away = street_lamps[k].xyz - p;
    float d2 = dot(away, away);
    lx += street_lamps[k].w * max(dot(normal, away), 0.0) / (d2 * sqrt(d2));
  }
  for (int k = 0; k < spot_count; k++) {
    vec3 away = spot_position[k].xyz - p;
    float d2 = dot(away, away);
    float most = spot_position[k].w * dot(normal, away) / (d2 * sqrt(d2));
    if (most < 1e-3) continue;
    float ahead = -dot(spot_axis[k], away);
    vec3 left = normalize(vec3(-spot_axis[k].y, spot_axis[k].x, 0.0));
    float across = -dot(left, away);
    float up = -dot(cross(spot_axis[k], left), away);
    vec2 angles = degrees(vec2(atan(across, ahead), atan(up, length(vec2(ahead, across)))));
    vec2 widths = angles / spot_width[k];
    lx += most * exp(-0.5 * dot(widths, widths));
  }
  return lx;
}
`;

/** What an eye sees of a luminance: linear up to 0.6 of white, then a shoulder. */
const DISPLAY = /* glsl */ `
uniform float luminance_gain; // of exposure, over white

float displayed(float cd_m2) {
  float x = cd_m2 * luminance_gain;
  x = x < 0.6 ? x : 1.0 - 0.4 * exp((0.6 - x) / 0.4);
  return x < 0.0031308 ? 12.92 * x : 1.055 * pow(x, 1.0 / 2.4) - 0.055;
}
`;

export const SURFACE_VERTEX = /* glsl */ `
${HEAD}
uniform mat4 modelMatrix;
uniform mat4 viewMatrix;
uniform mat4 projectionMatrix;
in vec3 position;
in vec3 normal;
out vec3 at;
out vec3 facing;
#ifdef TEXTURED
uniform vec4 box; // x_min, y_min, x_max, y_max
out vec2 on_texture;
#else
in float albedo;
out float reflected;
#endif

void main() {
  vec4 p = modelMatrix * vec4(position, 1.0);
  at = p.xyz;
  facing = mat3(modelMatrix) * normal;
#ifdef TEXTURED
  on_texture = (position.xy - box.xy) / (box.zw - box.xy);
#else
  reflected = albedo;
#endif
  gl_Position = projectionMatrix * viewMatrix * p;
}
`;

export const SURFACE_FRAGMENT = /* glsl */ `
${HEAD}
${LIGHT}
${OTHER_LIGHT}
${DISPLAY}
${COLOUR_MAP_GLSL}
uniform mat4 viewMatrix;
uniform bool lux;
uniform bool lines;
uniform bool numbers; // of the lines are sought: colours are places and the illuminance that they show
uniform vec3 ground_up;
const float ROUGH_M = 0.08;
uniform bool fog;
uniform float eye_extinction_per_m;
uniform sampler2D glow;
uniform vec2 canvas_px;
in vec3 at;
in vec3 facing;
#ifdef TEXTURED
uniform sampler2D albedo_texture;
in vec2 on_texture;
#else
in float reflected;
#endif
out vec4 colour;

void main() {
  vec3 normal = normalize(facing);
  vec3 plane = cross(dFdx(at), dFdy(at));
  if (!gl_FrontFacing) normal = -normal;
  float area = length(plane);
  plane = area > 0.0 ? plane / area : normal;
  if (dot(plane, normal) < 0.0) plane = -plane;
#ifdef TEXTURED
  float albedo = texture(albedo_texture, on_texture).r;
#else
  float albedo = reflected;
#endif
  float lx = lamps_lx(at, normal, plane, FLAT_M);
  float log_lx = lux || lines ? log(max(lx, 1e-3)) / log(10.0) : 0.0;
  float line = 0.0;
  if (lines) {
    // On a rough road every bump would have lines of its own, so they are those of the road's mean plane.
    vec3 level = dot(normal, ground_up) > 0.9 ? ground_up : normal;
    float level_lx = lamps_lx(at, level, level, ROUGH_M);
    if (numbers) {
      bool numbered = !shadows || level == ground_up; // the wall, or the road: lines on objects are short
      colour = vec4(at, numbered ? level_lx : 0.0);
      return;
    }
    line = isolux(log(max(level_lx, 1e-3)) / log(10.0));
  }
  vec3 shade;
  if (lux) {
    // Below the scale the surfaces show themselves, else nobody knows what stands there.
    vec3 unlit = vec3(0.03, 0.02, 0.05) + 0.2 * albedo;
    shade = mix(unlit, false_colour(log_lx), smoothstep(-2.0, -1.0, log_lx));
    shade = mix(shade, vec3(1.0), 0.75 * line);
  } else {
    float cd_m2 = albedo / 3.14159265 * (lx + other_lx(at, normal));
    if (fog) {
      cd_m2 = cd_m2 * exp(-eye_extinction_per_m * length((viewMatrix * vec4(at, 1.0)).xyz));
      cd_m2 += textureLod(glow, gl_FragCoord.xy / canvas_px, 0.0).r;
    }
    shade = vec3(displayed(cd_m2));
    if (lines) shade = mix(shade, mix(false_colour(log_lx), vec3(1.0), 0.2), 0.85 * line);
  }
  colour = vec4(shade, 1.0);
}
`;

/** Fog before the empty sky. */
export const SKY_FRAGMENT = /* glsl */ `
${HEAD}
${DISPLAY}
uniform sampler2D glow;
uniform vec2 canvas_px;
out vec4 colour;

void main() {
  colour = vec4(vec3(displayed(textureLod(glow, gl_FragCoord.xy / canvas_px, 0.0).r)), 1.0);
}
`;

/** A triangle over the whole canvas, at the far end. */
export const SCREEN_VERTEX = /* glsl */ `
${HEAD}
void main() {
  gl_Position = vec4(vec2(gl_VertexID & 1, gl_VertexID >> 1) * 4.0 - 1.0, 1.0, 1.0);
}
`;

export const DEPTH_VERTEX = /* glsl */ `
${HEAD}
uniform mat4 modelMatrix;
uniform mat4 viewMatrix;
uniform mat4 projectionMatrix;
in vec3 position;

void main() {
  gl_Position = projectionMatrix * viewMatrix * modelMatrix * vec4(position, 1.0);
}
`;

export const DEPTH_FRAGMENT = /* glsl */ `
${HEAD}
out vec4 colour;

void main() {
  colour = vec4(1.0);
}
`;

/** One pixel a point, row by row. */
export const PROBE_VERTEX = /* glsl */ `
${HEAD}
uniform vec2 probe_px;
in vec3 position;
in vec3 normal;
flat out vec3 at;
flat out vec3 facing;

void main() {
  at = position;
  facing = normal;
  vec2 pixel = vec2(gl_VertexID % int(probe_px.x), gl_VertexID / int(probe_px.x)) + 0.5;
  gl_Position = vec4(2.0 * pixel / probe_px - 1.0, 0.0, 1.0);
  gl_PointSize = 1.0;
}
`;

export const PROBE_FRAGMENT = /* glsl */ `
${HEAD}
${LIGHT}
flat in vec3 at;
flat in vec3 facing;
out vec4 colour;

void main() {
  colour = vec4(lamps_lx(at, facing, facing, FLAT_M), 0.0, 0.0, 1.0);
}
`;

/**
 * Light that the air scatters once, as `airlight` of world/light/volumetric.py has it: along the part of a view ray within a module's
 * pyramid, in equal steps of the angle at the module, in which ds / d^2 is uniform.
 */
export const FOG_FRAGMENT = /* glsl */ `
${HEAD}
${LIGHT}
uniform sampler2D scene_depth;
uniform mat4 local_from_clip;
uniform float scattering_per_m;
uniform float eye_extinction_per_m;
uniform float asymmetry;
uniform float farthest_m;
out vec4 colour;
const int STEPS = 20;

float phase(float cosine) {
  float g = asymmetry;
  float spread = inversesqrt(1.0 + g * g - 2.0 * g * cosine);
  return (1.0 - g * g) / (4.0 * 3.14159265) * spread * spread * spread;
}

/** Narrows a part of a ray to the positive side of a plane. */
void cut(float at_eye, float slope, inout float near, inout float far) {
  if (slope > 0.0) near = max(near, -at_eye / slope);
  else if (slope < 0.0) far = min(far, -at_eye / slope);
  else if (at_eye < 0.0) far = -1.0;
}

vec3 unprojected(vec2 place, float depth) {
  vec4 p = local_from_clip * vec4(place, depth, 1.0);
  return p.xyz / p.w;
}

void main() {
  ivec2 texel = ivec2(gl_FragCoord.xy);
  vec2 place = 2.0 * gl_FragCoord.xy / vec2(textureSize(scene_depth, 0)) - 1.0;
  float depth = texelFetch(scene_depth, texel, 0).r;
  vec3 eye = unprojected(place, -1.0);
  vec3 way = unprojected(place, 2.0 * depth - 1.0) - eye;
  float length_m = min(length(way), farthest_m);
  vec3 ray = normalize(unprojected(place, 1.0) - eye);
  float light = 0.0;
  for (int k = 0; k < module_count; k++) {
    vec3 e = (module_pose[k] * vec4(eye, 1.0)).xyz;
    vec3 r = mat3(module_pose[k]) * ray;
    vec4 b = module_borders[k];
    float near = 0.0;
    float far = length_m;
    cut(e.y - b.y * e.x, r.y - b.y * r.x, near, far);
    cut(b.x * e.x - e.y, b.x * r.x - r.y, near, far);
    cut(e.z - b.z * e.x, r.z - b.z * r.x, near, far);
    cut(b.w * e.x - e.z, b.w * r.x - r.z, near, far);
    cut(e.x, r.x, near, far);
    if (far <= near) continue;
    float closest = -dot(e, r);
    float height = max(length(e + closest * r), 0.02);
    float first = atan((near - closest) / height);
    float step_rad = (atan((far - closest) / height) - first) / float(STEPS);
    float sum = 0.0;
    for (int i = 0; i < STEPS; i++) {
      float angle = first + (float(i) + 0.5) * step_rad;
      float along = closest + height * tan(angle);
      float cd = intensity(k, e + along * r);
      if (cd <= 0.0) continue;
      float lost = extinction_per_m * height / cos(angle) + eye_extinction_per_m * along;
      float lit = shadows ? unshadowed_air(int(module_light[k].y), eye + along * ray) : 1.0;
      sum += cd * lit * phase(-sin(angle)) * exp(-lost);
    }
    light += sum * scattering_per_m * step_rad / height;
  }
  colour = vec4(light, 0.0, 0.0, 1.0);
}
`;
