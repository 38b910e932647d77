// Cast shadows of a light that turns: what each vertex sees of K shared directions, one bit each, comes with the page.
//
// Notation: as in sira_assets/render/visibility_table.py. S_pi = sum_k V_pk (n_p . w_k)+ G_i(w_k) over the same without
// V; the directions are even, so their solid angle cancels. Lobes sharper than the directions can tell are widened.
const NO_LIGHT = 1e-12;

export class Shadows {
  /** `said` has directions and sharpest; `packed` K / 8 bytes a vertex, the highest bit first; normals 3 a vertex. */
  constructor(said, packed, normals) {
    this.said = said;
    this.packed = packed;
    this.normals = normals;
    this.count = normals.length / 3;
  }

  /** Shares, one Float32Array of 4 a vertex for every four lobes, from axes [x, y, z] and sharpnesses. */
  shares(axes, sharpness) {
    const { directions, sharpest } = this.said, count = directions.length, lobes = axes.length;
    const stride = 4 * Math.ceil(lobes / 4), bytes = Math.ceil(count / 8);
    const g = new Float64Array(count * stride);
    directions.forEach((w, k) => axes.forEach((xi, i) => {
      const apart = (w[0] - xi[0]) ** 2 + (w[1] - xi[1]) ** 2 + (w[2] - xi[2]) ** 2;
      g[k * stride + i] = Math.exp(-0.5 * sharpness[i] / (1 + sharpness[i] / sharpest) * apart);
    }));
    const w = Float64Array.from(directions.flat());
    const out = Array.from({ length: stride / 4 }, () => new Float32Array(4 * this.count).fill(1));
    const reached = new Float64Array(stride), received = new Float64Array(stride);
    for (let p = 0; p < this.count; p++) {
      const x = this.normals[3 * p], y = this.normals[3 * p + 1], z = this.normals[3 * p + 2];
      reached.fill(NO_LIGHT);
      received.fill(NO_LIGHT);
      for (let k = 0; k < count; k++) {
        const cosine = x * w[3 * k] + y * w[3 * k + 1] + z * w[3 * k + 2];
        if (cosine <= 0) continue;
        const sees = this.packed[p * bytes + (k >> 3)] >> (7 - (k & 7)) & 1, row = k * stride;
        for (let i = 0; i < lobes; i++) {
          const part = cosine * g[row + i];
          received[i] += part;
          if (sees) reached[i] += part;
        }
      }
      for (let i = 0; i < lobes; i++) out[i >> 2][4 * p + (i & 3)] = reached[i] / received[i];
    }
    return out;
  }
}
