// The avatar on a canvas: GLTFLoader's meshes under our own material, drawn when something changed.
import {
  BufferAttribute, LinearSRGBColorSpace, Matrix3, Scene, Vector3, WebGLRenderer,
} from "three";
import { GLTFLoader } from "three/examples/jsm/loaders/GLTFLoader.js";
import { OrbitCamera } from "./camera.js";
import { lobeTexture, MAPS, setLobes, sgMaterial } from "./material.js";
import { Shadows } from "./shadows.js";

const turned = ([x, y, z], [a, b, c], angle) => {
  // Rodrigues, about the unit axis (a, b, c).
  const s = Math.sin(angle), t = Math.cos(angle), along = (1 - t) * (a * x + b * y + c * z);
  return [t * x + s * (b * z - c * y) + along * a, t * y + s * (c * x - a * z) + along * b, t * z + s * (a * y - b * x) + along * c];
};

export class HeadView {
  /** Reads the GLB and readies everything; `form` is the page's JSON, `packed` the shadows' bytes or null. */
  static async on(canvas, form, glb, packed) {
    const gltf = await new GLTFLoader().parseAsync(glb, "");
    return new HeadView(canvas, form, gltf.scene, packed);
  }

  constructor(canvas, form, root, packed) {
    this.form = form;
    this.root = root;
    this.renderer = new WebGLRenderer({ canvas, antialias: true, alpha: true, premultipliedAlpha: true });
    // The material writes sRGB itself.
    this.renderer.outputColorSpace = LinearSRGBColorSpace;
    this.renderer.setClearColor(0x000000, 0);
    this.scene = new Scene();
    this.scene.add(root);
    this.scene.updateMatrixWorld(true);
    this.meshes = [];
    root.traverse((node) => { if (node.isMesh) this.meshes.push(node); });
    this.orbit = new OrbitCamera(form.camera, form.pivot, form.up, form.radius);
    this.lobes = lobeTexture(form.lobes.length);
    this.uniforms = {
      lobes: { value: this.lobes },
      camera_world: { value: new Vector3() },
      camera_from_world: { value: new Matrix3() },
      gain: { value: 1 },
      white_f0: { value: form.white_f0 },
      white_light: { value: form.white_light },
      show: { value: 0 },
    };
    const vertices = this.meshes.reduce((sum, mesh) => sum + mesh.geometry.getAttribute("position").count, 0);
    // The table has a row for every vertex of the file, in its order; a reader that keeps another order has no shadows.
    this.canShade = packed !== null && packed.length === vertices * Math.ceil(form.shadows.directions.length / 8);
    this.shaded = this.canShade;
    this.azimuth = 0;
    const groups = this.canShade ? Math.ceil(form.lobes.length / 4) : 0;
    const anisotropy = this.renderer.capabilities.getMaxAnisotropy();
    for (const mesh of this.meshes) {
      for (const map of ["map", "normalMap", "specularColorMap", "specularIntensityMap"]) {
        if (mesh.material[map]) mesh.material[map].anisotropy = Math.min(8, anisotropy);
      }
      const count = mesh.geometry.getAttribute("position").count;
      for (let g = 0; g < groups; g++) mesh.geometry.setAttribute(`shade_${g}`, new BufferAttribute(new Float32Array(4 * count), 4));
      mesh.material = sgMaterial(mesh.material, mesh.geometry, form, this.uniforms, groups);
      mesh.frustumCulled = false;
    }
    if (this.canShade) this.shadows = new Shadows(form.shadows, packed, this.normals());
    this.light();
  }

  /** All vertices' normals in the world, in the file's order. */
  normals() {
    const out = [], n = new Vector3();
    for (const mesh of this.meshes) {
      const linear = new Matrix3().getNormalMatrix(mesh.matrixWorld), normal = mesh.geometry.getAttribute("normal");
      for (let i = 0; i < normal.count; i++) out.push(...n.fromBufferAttribute(normal, i).applyMatrix3(linear).normalize().toArray());
    }
    return Float64Array.from(out);
  }

  /** Put the light where `azimuth` (radians) and `shaded` say. */
  light() {
    const axes = this.form.lobes.map((lobe) => turned(lobe.axis, this.form.up, this.azimuth));
    setLobes(this.lobes, this.form.lobes, axes);
    if (!this.canShade) return;
    const shares = this.shaded ? this.shadows.shares(axes, this.form.lobes.map((lobe) => lobe.sharpness)) : null;
    let start = 0;
    for (const mesh of this.meshes) {
      const count = mesh.geometry.getAttribute("position").count;
      for (let g = 0; g < Math.ceil(axes.length / 4); g++) {
        const attribute = mesh.geometry.getAttribute(`shade_${g}`);
        if (shares) attribute.array.set(shares[g].subarray(4 * start, 4 * (start + count)));
        else attribute.array.fill(1);
        attribute.needsUpdate = true;
      }
      start += count;
    }
  }

  show(map) {
    this.uniforms.show.value = MAPS.indexOf(map);
  }

  expose(stops) {
    this.uniforms.gain.value = 2 ** stops;
  }

  draw() {
    this.uniforms.camera_world.value.copy(this.orbit.eye);
    this.uniforms.camera_from_world.value.setFromMatrix4(this.orbit.camera.matrixWorldInverse);
    this.renderer.render(this.scene, this.orbit.camera);
  }

  resize(width, height) {
    this.renderer.setSize(width, height, false);
  }

  /** Milliseconds that a picture of the present size takes, until the last pixel stands. */
  async time() {
    const gl = this.renderer.getContext(), start = performance.now();
    this.draw();
    const fence = gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0);
    gl.flush();
    while (gl.clientWaitSync(fence, 0, 0) === gl.TIMEOUT_EXPIRED) await new Promise((done) => setTimeout(done, 2));
    gl.deleteSync(fence);
    return performance.now() - start;
  }

  /** The picture as PNG, width x height pixels, transparent behind. */
  snapshot(width, height) {
    const canvas = this.renderer.domElement, { width: w, height: h } = canvas;
    this.resize(width, height);
    this.draw();
    const url = canvas.toDataURL("image/png");
    this.resize(w, h);
    this.draw();
    return url;
  }
}
