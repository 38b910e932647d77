// The avatar's surface under spherical gaussian light, in closed form: sira_assets/numerics and relight in GLSL.
//
// Notation: n normal, v direction to the camera; per lobe i axis xi, sharpness lambda, amplitude mu. A lobe's texels are
// (xi, lambda), (mu, E(0)), (O, root, c0, c1), (c2, c3, c4, -): the constants of numerics.sg_irradiance, which come
// with the page, as do all other fitted numbers. Radiance is linear until the last line, which encodes it as sRGB.
import {
  DataTexture, DoubleSide, FloatType, GLSL3, NearestFilter, RawShaderMaterial, RGBAFormat, RGFormat, Vector3,
} from "three";

export const MAPS = ["final", "diffuse", "specular", "normals", "light"];

const VERTEX = `
precision highp float;
in vec3 position; in vec3 normal;
#ifdef HAS_UV
in vec2 uv;
#endif
#ifdef HAS_TANGENT
in vec4 tangent; out vec4 t_world;
#endif
#ifdef HAS_COLOUR
in vec3 color;
#endif
#if SHADES > 0
SHADE_INPUTS
out vec4 shade[SHADES];
#endif
uniform mat4 modelMatrix, viewMatrix, projectionMatrix;
out vec3 x_world, n_world, tint; out vec2 at_uv;
void main() {
  vec4 x = modelMatrix * vec4(position, 1.0);
  mat3 linear = mat3(modelMatrix);
  x_world = x.xyz;
  n_world = normalize(transpose(inverse(linear)) * normal);
#ifdef HAS_UV
  at_uv = uv;
#else
  at_uv = vec2(0.0);
#endif
#ifdef HAS_TANGENT
  t_world = vec4(normalize(linear * tangent.xyz), tangent.w);
#endif
#ifdef HAS_COLOUR
  tint = color;
#else
  tint = vec3(1.0);
#endif
#if SHADES > 0
SHADE_COPIES
#endif
  gl_Position = projectionMatrix * viewMatrix * x;
}`;

const FRAGMENT = `
precision highp float; precision highp int; precision highp sampler2D;
in vec3 x_world, n_world, tint; in vec2 at_uv;
#ifdef HAS_TANGENT
in vec4 t_world;
#endif
#if SHADES > 0
in vec4 shade[SHADES];
#endif
uniform vec3 camera_world;
uniform mat3 camera_from_world;
uniform sampler2D lobes, albedo_table, base_map, specular_map, weight_map, normal_map;
uniform vec3 base_factor, specular_factor;
uniform float roughness, f0_dielectric, weight_factor, normal_scale, gain, white_f0, white_light;
uniform int show;
out vec4 colour;
const float PI = 3.14159265358979;

vec3 srgb(vec3 x) {
  x = clamp(x, 0.0, 1.0);
  return mix(12.92 * x, 1.055 * pow(max(x, vec3(1e-9)), vec3(1.0 / 2.4)) - 0.055, step(0.0031308, x));
}

// int G max(n . w, 0) dw (sg_irradiance.irradiance_accurate)
float irradiance(float cosine, float edge, vec4 p, vec4 q) {
  float away = abs(cosine), x = away * p.y;
  float tail = (((q.z * x + q.y) * x + q.x) * x + p.w) * x + p.z;
  return edge * exp(-x * tail) + p.x * (cosine + away);
}

// int G nl / (nl (1 - k) + k) dl (sg_specular._masked over sg_irradiance.integral_and_mean_cosine)
float masked(float cosine, float sharpness, float k) {
  cosine = clamp(cosine, -1.0, 1.0);
  sharpness = max(sharpness, MEAN_FLOOR);
  float opposite = exp(-2.0 * sharpness), inverse = 1.0 / sharpness;
  float tau = sharpness / (sharpness + MEAN_TAU_SCALE);
  float edge = 0.25 * inversesqrt(1.0 + sharpness * ((MEAN_EDGE_2 * tau + MEAN_EDGE_1) * tau + MEAN_EDGE_0));
  float slope = (1.0 + opposite) / (1.0 - opposite) - inverse;
  float away = abs(cosine), root = sqrt(sharpness + 1.0), x = away * root;
  float bend = tau * tau * x * (MEAN_TAIL_0 + MEAN_TAIL_1 * x);
  float mean = edge * exp(-x * (0.5 * slope / (edge * root) + bend)) + 0.5 * slope * (cosine + away);
  return 2.0 * PI * (1.0 - opposite) * inverse * mean / (mean * (1.0 - k) + k);
}

// The mean of (1 - v . h)^5 over a lobe's light: what glTF's 1 - F takes from it (relight.gltf_shading.grazing_share)
float grazing(vec3 n, vec3 v, vec3 axis, float sharpness) {
  vec3 centre = sharpness * axis + COSINE_SHARPNESS * n;
  float width = max(length(centre), 1e-3);
  float along = clamp(dot(centre, v) / width, -1.0, 1.0);
  float across = sqrt(max(1.0 - along * along, 0.0)), far = exp(-2.0 * width) - 1.0, sum = 0.0;
  for (int i = 0; i < 4; i++) {
    float c = clamp(1.0 + log(1.0 + (float(i) + 0.5) / 4.0 * far) / width, -1.0, 1.0);
    float s = sqrt(max(1.0 - c * c, 0.0));
    for (int j = 0; j < 4; j++) {
      float m = 1.0 - sqrt(max(0.5 + 0.5 * (c * along + s * across * cos(PI * (float(j) + 0.5) / 4.0)), 0.0));
      sum += m * m * m * m * m;
    }
  }
  return sum / 16.0;
}

float seen(int i) {
#if SHADES > 0
  return shade[i / 4][i % 4];
#else
  return 1.0;
#endif
}

void main() {
  vec3 v = normalize(camera_world - x_world), n = normalize(n_world);
#ifdef HAS_TANGENT
  vec3 local = texture(normal_map, at_uv).xyz * 2.0 - 1.0;
  local.xy *= normal_scale;
  n = normalize(local.x * t_world.xyz + local.y * sign(t_world.w) * cross(n, t_world.xyz) + local.z * n);
#endif
  if (!gl_FrontFacing) n = -n;
  // A smooth normal that turns away along a silhouette is lit as seen edge-on.
  n = normalize(n - min(dot(n, v), 0.0) * v);

  vec3 base = min(base_factor * texture(base_map, at_uv).rgb * tint, 1.0);
  float weight = weight_factor * texture(weight_map, at_uv).a;
  vec3 f0 = weight * min(f0_dielectric * specular_factor * texture(specular_map, at_uv).rgb, 1.0);
  if (show == 1) { colour = vec4(srgb(base), 1.0); return; }
  if (show == 2) { colour = vec4(clamp(f0 / white_f0, 0.0, 1.0), 1.0); return; }
  if (show == 3) { colour = vec4(0.5 + 0.5 * camera_from_world * n, 1.0); return; }

  float alpha2 = roughness * roughness * roughness * roughness;
  float k = (roughness + 1.0) * (roughness + 1.0) / 8.0;
  float nv = clamp(dot(n, v), COSINE_FLOOR, 1.0), warped = 0.5 / (alpha2 * nv);
  vec3 mirror = normalize(2.0 * dot(n, v) * n - v);
  float largest = max(f0.r, max(f0.g, f0.b));
  vec3 received = vec3(0.0), diffuse = vec3(0.0), reflected = vec3(0.0);
  for (int i = 0; i < LOBES; i++) {
    vec4 a = texelFetch(lobes, ivec2(0, i), 0), b = texelFetch(lobes, ivec2(1, i), 0);
    vec4 p = texelFetch(lobes, ivec2(2, i), 0), q = texelFetch(lobes, ivec2(3, i), 0);
    float c = clamp(dot(n, a.xyz), -1.0, 1.0);
    vec3 e = seen(i) * irradiance(c, b.w, p, q) * b.rgb;
    received += e;
    if (show != 0) continue;
    diffuse += e * (1.0 - largest - (weight - largest) * grazing(n, v, a.xyz, a.w));
    vec3 apart = mirror - a.xyz;
    float summed = warped + a.w, crossed = warped * a.w * dot(apart, apart);
    float sharp = sqrt(max(summed * summed - crossed, 1e-14 * summed * summed));
    float lobe = exp(-crossed / (sharp + summed));
    reflected += seen(i) * lobe * masked((0.5 / alpha2 + a.w * dot(n, a.xyz)) / sharp, sharp, k) * b.rgb;
  }
  if (show == 4) { colour = vec4(srgb(gain * received / white_light), 1.0); return; }
  float position = sqrt(nv) * float(KNOTS - 1);
  int left = clamp(int(position), 0, KNOTS - 2);
  vec2 albedo = mix(
    texelFetch(albedo_table, ivec2(left, 0), 0).rg, texelFetch(albedo_table, ivec2(left + 1, 0), 0).rg,
    position - float(left));
  vec3 specular = (f0 * albedo.x + weight * albedo.y) / masked(nv, warped, k) * reflected;
  colour = vec4(srgb(gain * (base * max(diffuse, 0.0) / PI + specular)), 1.0);
}`;

const number = (x) => (Number.isInteger(x) ? x.toFixed(1) : String(x));

function floats(data, width, height, format) {
  const texture = new DataTexture(data, width, height, format, FloatType);
  texture.minFilter = texture.magFilter = NearestFilter;
  texture.needsUpdate = true;
  return texture;
}

/** The lobes' texels, to be filled by `setLobes`. */
export function lobeTexture(count) {
  return floats(new Float32Array(16 * Math.max(count, 1)), 4, Math.max(count, 1), RGBAFormat);
}

/** Lobes with their axes as given, [x, y, z] each. */
export function setLobes(texture, lobes, axes) {
  lobes.forEach((lobe, i) => {
    const [edge, odd, root, ...tail] = lobe.irradiance;
    texture.image.data.set(
      [...axes[i], lobe.sharpness, ...lobe.amplitude, edge, odd, root, tail[0], tail[1], tail[2], tail[3], tail[4], 0],
      16 * i,
    );
  });
  texture.needsUpdate = true;
}

/** A material that stands in for one of GLTFLoader's; `uniforms` are shared by all of the avatar. */
export function sgMaterial(standard, geometry, form, uniforms, shades) {
  const white = floats(new Float32Array([1, 1, 1, 1]), 1, 1, RGBAFormat);
  const f0 = ((standard.ior ?? 1.5) - 1) / ((standard.ior ?? 1.5) + 1);
  const near = (a, b) => (Math.abs(b.roughness - standard.roughness) < Math.abs(a.roughness - standard.roughness) ? b : a);
  const table = form.albedo.reduce(near);
  const knots = table.scale.length;
  const defines = {
    LOBES: form.lobes.length, SHADES: shades, KNOTS: knots, COSINE_FLOOR: number(form.cosine_floor),
    COSINE_SHARPNESS: number(form.cosine_sharpness), MEAN_FLOOR: number(form.mean.floor),
    MEAN_TAU_SCALE: number(form.mean.tau_scale),
  };
  form.mean.edge.forEach((x, i) => { defines[`MEAN_EDGE_${i}`] = number(x); });
  form.mean.tail.forEach((x, i) => { defines[`MEAN_TAIL_${i}`] = number(x); });
  if (geometry.getAttribute("uv")) defines.HAS_UV = 1;
  if (geometry.getAttribute("color")) defines.HAS_COLOUR = 1;
  if (geometry.getAttribute("tangent") && standard.normalMap) defines.HAS_TANGENT = 1;
  const lines = (line) => Array.from({ length: shades }, (_, i) => line(i)).join("\n");
  return new RawShaderMaterial({
    glslVersion: GLSL3,
    side: DoubleSide,
    defines,
    vertexShader: VERTEX.replace("SHADE_INPUTS", lines((i) => `in vec4 shade_${i};`))
      .replace("SHADE_COPIES", lines((i) => `  shade[${i}] = shade_${i};`)),
    fragmentShader: FRAGMENT,
    uniforms: {
      ...uniforms,
      albedo_table: { value: floats(new Float32Array(table.scale.flatMap((a, i) => [a, table.bias[i]])), knots, 1, RGFormat) },
      base_map: { value: standard.map ?? white },
      specular_map: { value: standard.specularColorMap ?? white },
      weight_map: { value: standard.specularIntensityMap ?? white },
      normal_map: { value: standard.normalMap ?? white },
      base_factor: { value: new Vector3(standard.color.r, standard.color.g, standard.color.b) },
      specular_factor: { value: standard.specularColor ? new Vector3(standard.specularColor.r, standard.specularColor.g, standard.specularColor.b) : new Vector3(1, 1, 1) },
      weight_factor: { value: standard.specularIntensity ?? 1 },
      normal_scale: { value: standard.normalScale?.x ?? 1 },
      roughness: { value: table.roughness },
      f0_dielectric: { value: f0 * f0 },
    },
  });
}
