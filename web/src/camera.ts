// A pinhole camera in the pose of OpenGL that turns about a target.

import { Vector, add, cross, dot, subtract, times, turned, unit } from "./vectors";

/** The 4 x 4 matrix `world_from_camera` by rows, the vertical field of view in degrees, and the distance of the target. */
export interface CameraState {
  pose: number[];
  fov: number;
  distance: number;
}

export class Camera {
  right!: Vector;
  up!: Vector;
  back!: Vector;
  eye!: Vector;
  fov!: number;
  distance!: number;
  /** The world axis that stays upright. */
  private upright: Vector = [0, 1, 0];

  constructor(private readonly first: CameraState) {
    this.set(first);
    const sizes = this.up.map(Math.abs);
    const axis = sizes.indexOf(Math.max(...sizes));
    // The axis nearest to the first camera's up vector stays upright. The y axis wins unless it is clearly farther away.
    const chosen = sizes[1] > 0.7 * sizes[axis] ? 1 : axis;
    this.upright = [0, 0, 0];
    this.upright[chosen] = Math.sign(this.up[chosen]) || 1;
  }

  get target(): Vector {
    return subtract(this.eye, times(this.back, this.distance));
  }

  get state(): CameraState {
    const { right, up, back, eye } = this;
    const pose = [0, 1, 2].flatMap((i) => [right[i], up[i], back[i], eye[i]]);
    return { pose: [...pose, 0, 0, 0, 1], fov: this.fov, distance: this.distance };
  }

  set(state: CameraState): void {
    const column = (j: number): Vector => [state.pose[j], state.pose[4 + j], state.pose[8 + j]];
    this.right = unit(column(0));
    this.up = unit(column(1));
    this.back = unit(column(2));
    this.eye = column(3);
    this.fov = state.fov;
    this.distance = state.distance;
  }

  reset(): void {
    this.set(this.first);
  }

  /** Turn about the target by two angles in radians. */
  orbit(across: number, upwards: number): void {
    const target = this.target;
    const height = Math.asin(Math.max(-1, Math.min(1, dot(this.back, this.upright))));
    // A camera that starts beyond the limit can only tilt back.
    const most = Math.max(0.49 * Math.PI, Math.abs(height));
    const tilt = Math.max(-most, Math.min(most, height + upwards)) - height;
    const turn = (v: Vector) => turned(turned(v, this.right, -tilt), this.upright, -across);
    const [right, up, back] = [turn(this.right), turn(this.up), turn(this.back)];
    this.right = unit(right);
    this.back = unit(back);
    this.up = unit(cross(this.back, this.right));
    if (dot(this.up, up) < 0) this.up = times(this.up, -1);
    this.eye = add(target, times(this.back, this.distance));
  }

  /** Move the camera parallel to the picture. Both shares are relative to the picture's height at the target. */
  pan(across: number, upwards: number): void {
    const height = 2 * this.distance * Math.tan((this.fov * Math.PI) / 360);
    this.eye = add(this.eye, add(times(this.right, -across * height), times(this.up, upwards * height)));
  }

  zoom(factor: number): void {
    const target = this.target;
    this.distance *= factor;
    this.eye = add(target, times(this.back, this.distance));
  }

  /** Side of a pixel on the plane at depth 1, for a picture of `height` pixels. */
  pixel(height: number): number {
    return (2 * Math.tan((this.fov * Math.PI) / 360)) / height;
  }

  /** Direction through the centre of a pixel, row 0 on top, one unit long along the viewing axis. */
  through(x: number, y: number, width: number, height: number): Vector {
    const pixel = this.pixel(height);
    const across = times(this.right, (x + 0.5 - 0.5 * width) * pixel);
    const upwards = times(this.up, (0.5 * height - 0.5 - y) * pixel);
    return subtract(add(across, upwards), this.back);
  }

  /** Distance of a point from the eye along the viewing axis. */
  depth(p: Vector): number {
    return -dot(subtract(p, this.eye), this.back);
  }
}
