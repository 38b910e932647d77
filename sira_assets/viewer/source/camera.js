// The portrait's camera, and how it is carried around the head.
//
// Notation: K the pinhole's 3 x 3 matrix in pixels, u = K x / z with OpenCV axes (x right, y down, z forward); three.js
// looks along -z with y up. The lens never changes: a zoom carries the camera nearer, as a person would walk.
import { Camera, Matrix4, Quaternion, Vector3 } from "three";

const STEEPEST = 85 * Math.PI / 180; // above and below the horizon
const FILLED = 0.46; // of the picture's shorter side, by the avatar's radius
const NEAREST = 0.15, FARTHEST = 6; // distance to the pivot, shares of the first one

const matrix = (rows) => new Matrix4().set(...rows.flat());

export class OrbitCamera {
  /** `said` is the page's camera: intrinsics, world_from_camera, width, height. The pivot and radius bound the avatar. */
  constructor(said, pivot, up, radius) {
    this.said = said;
    this.up = new Vector3(...up).normalize();
    this.radius = radius;
    this.firstPivot = new Vector3(...pivot);
    this.first = matrix(said.world_from_camera).multiply(new Matrix4().makeScale(1, -1, -1));
    this.camera = new Camera();
    this.camera.matrixAutoUpdate = false;
    this.reset();
  }

  reset() {
    this.pivot = this.firstPivot.clone();
    this.pose = this.first.clone();
    this.place();
  }

  /** Whether the camera stands where the photo was taken. */
  get atPhoto() {
    return this.pose.elements.every((x, i) => Math.abs(x - this.first.elements[i]) < 1e-9);
  }

  get eye() {
    return new Vector3().setFromMatrixPosition(this.pose);
  }

  axis(column) {
    return new Vector3().setFromMatrixColumn(this.pose, column);
  }

  turnAbout(axis, angle) {
    const turn = new Matrix4().makeRotationFromQuaternion(new Quaternion().setFromAxisAngle(axis, angle));
    const to = new Matrix4().makeTranslation(this.pivot), from = new Matrix4().makeTranslation(this.pivot.clone().negate());
    this.pose.premultiply(from).premultiply(turn).premultiply(to);
  }

  /** Turn to the right and upwards, in radians; the elevation stops short of the poles. */
  orbit(right, upwards) {
    this.turnAbout(this.up, right);
    const towards = this.eye.sub(this.pivot).normalize();
    const now = Math.asin(Math.max(-1, Math.min(1, towards.dot(this.up))));
    const wanted = Math.max(Math.min(-STEEPEST, now), Math.min(Math.max(STEEPEST, now), now + upwards));
    const side = new Vector3().crossVectors(this.up, towards);
    if (side.lengthSq() > 1e-9) this.turnAbout(side.normalize(), now - wanted);
    this.place();
  }

  /** Carry the camera to where the whole avatar fills the picture, looking as it looks. */
  frame() {
    const [[fx, skew, cx], [, fy, cy]] = this.said.intrinsics, { width: w, height: h } = this.said;
    this.pivot = this.firstPivot.clone();
    const depth = Math.min(fx, fy) * this.radius / (FILLED * Math.min(w, h)), y = (h / 2 - cy) / fy;
    const middle = new Vector3((w / 2 - cx - skew * y) / fx, -y, -1).multiplyScalar(depth);
    const inWorld = this.axis(0).multiplyScalar(middle.x).add(this.axis(1).multiplyScalar(middle.y))
      .add(this.axis(2).multiplyScalar(middle.z));
    this.pose.setPosition(this.pivot.clone().sub(inWorld));
    this.place();
  }

  /** Nearer by a factor above 1, along the ray to the pivot. */
  zoom(factor) {
    const from = this.eye.sub(this.pivot), first = new Vector3().setFromMatrixPosition(this.first).sub(this.firstPivot);
    const length = Math.max(NEAREST, Math.min(FARTHEST, from.length() / factor / first.length())) * first.length();
    this.pose.setPosition(from.setLength(length).add(this.pivot));
    this.place();
  }

  /** Slide sideways, in shares of the picture's height. */
  pan(right, upwards) {
    const scale = this.eye.distanceTo(this.pivot) * this.said.height / this.said.intrinsics[1][1];
    const move = this.axis(0).multiplyScalar(-right * scale).add(this.axis(1).multiplyScalar(-upwards * scale));
    this.pose.setPosition(this.eye.add(move));
    this.pivot.add(move);
    this.place();
  }

  place() {
    const [[fx, skew, cx], [, fy, cy]] = this.said.intrinsics, { width: w, height: h } = this.said;
    // Near and far enclose the avatar, wherever the camera stands.
    const depth = this.eye.distanceTo(this.firstPivot);
    const far = depth + 1.5 * this.radius, near = Math.max(depth - 1.5 * this.radius, 0.002 * far);
    const p = this.camera.projectionMatrix.set(
      2 * fx / w, -2 * skew / w, 1 - 2 * cx / w, 0,
      0, 2 * fy / h, 2 * cy / h - 1, 0,
      0, 0, -(far + near) / (far - near), -2 * far * near / (far - near),
      0, 0, -1, 0,
    );
    this.camera.projectionMatrixInverse.copy(p).invert();
    this.camera.matrix.copy(this.pose);
    this.camera.matrixWorldNeedsUpdate = true;
    this.camera.updateMatrixWorld(true);
  }
}
