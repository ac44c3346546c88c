// What this device measures: images of its camera, and its motion.

import { image, imu } from "./wire.js";
import { nowNs } from "./link.js";

const DEGREE = Math.PI / 180;
const FRAME = { width: 640, height: 480 };
const IMAGES_PER_SECOND = 10;
// Formats of WebCodecs that begin with eight bits of luma for each pixel.
const LUMA_FIRST = ["I420", "I420A", "I422", "I422A", "I444", "I444A", "NV12"];

const HEADER = `builtin_interfaces/Time stamp
string frame_id
`;
const rule = "=".repeat(80);
const header = `${rule}
MSG: std_msgs/Header
${HEADER}${rule}
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
`;

export const SCHEMAS = {
  image: {
    name: "sensor_msgs/msg/Image",
    text: `std_msgs/Header header
uint32 height
uint32 width
string encoding
uint8 is_bigendian
uint32 step
uint8[] data
${header}`,
  },
  imu: {
    name: "sensor_msgs/msg/Imu",
    text: `std_msgs/Header header
geometry_msgs/Quaternion orientation
float64[9] orientation_covariance
geometry_msgs/Vector3 angular_velocity
float64[9] angular_velocity_covariance
geometry_msgs/Vector3 linear_acceleration
float64[9] linear_acceleration_covariance
${header}${rule}
MSG: geometry_msgs/Quaternion
float64 x
float64 y
float64 z
float64 w
${rule}
MSG: geometry_msgs/Vector3
float64 x
float64 y
float64 z
`,
  },
};

// Asks for the camera and hands on grey images. `put(timeNs, bytes)`; false: there was no room.
export class Camera {
  constructor(video, put) {
    Object.assign(this, { video, put, images: 0, leftOut: 0 });
    this.canvas = document.createElement("canvas");
  }

  async start() {
    this.stream = await navigator.mediaDevices.getUserMedia({
      audio: false,
      video: { facingMode: "environment", width: { ideal: FRAME.width }, height: { ideal: FRAME.height } },
    });
    this.video.srcObject = this.stream;
    await this.video.play();
    this.nextMs = 0;
    this.wait();
  }

  stop() {
    this.stream?.getTracks().forEach((track) => track.stop());
    this.stream = null;
    this.video.srcObject = null;
  }

  wait() {
    if (!this.stream) return;
    if (this.video.requestVideoFrameCallback) {
      this.video.requestVideoFrameCallback((now, metadata) => this.frame(metadata.captureTime ?? now));
    } else {
      setTimeout(() => this.frame(performance.now()), 1_000 / IMAGES_PER_SECOND);
    }
  }

  frame(capturedMs) {
    if (!this.stream) return;
    if (capturedMs >= this.nextMs) {
      // The rhythm of the camera is kept: a frame that is a little early is not passed over.
      this.nextMs = capturedMs + 900 / IMAGES_PER_SECOND;
      this.take(capturedMs);
    }
    this.wait();
  }

  async take(capturedMs) {
    const { videoWidth: width, videoHeight: height } = this.video;
    // One after the other: a frame that comes while the last one is copied is passed over, as is one that ends behind the walk.
    if (width === 0 || this.copies) return;
    this.copies = true;
    const grey = await this.luma(width, height).finally(() => (this.copies = false));
    if (!this.stream) return;
    const timeNs = BigInt(Math.round(capturedMs * 1e6));
    const pixels = grey ?? this.fromColours(width, height);
    if (this.put(timeNs, image(timeNs, "cam0", width, height, pixels))) this.images += 1;
    else this.leftOut += 1;
  }

  // The frame's own luma, by WebCodecs: nothing where there is none, or where it lies otherwise than it is shown.
  async luma(width, height) {
    if (!globalThis.VideoFrame) return null;
    let frame;
    try {
      frame = new VideoFrame(this.video, { timestamp: 0 });
      const { visibleRect: seen } = frame;
      const isAsShown = !frame.rotation && !frame.flip && seen.width === width && seen.height === height;
      if (!isAsShown || !LUMA_FIRST.includes(frame.format)) return null;
      const bytes = new Uint8Array(frame.allocationSize());
      const [{ offset, stride }] = await frame.copyTo(bytes);
      const grey = new Uint8Array(width * height);
      for (let row = 0; row < height; row += 1) {
        grey.set(bytes.subarray(offset + row * stride, offset + row * stride + width), row * width);
      }
      return grey;
    } catch {
      return null;
    } finally {
      frame?.close();
    }
  }

  fromColours(width, height) {
    Object.assign(this.canvas, { width, height });
    const context = this.canvas.getContext("2d", { willReadFrequently: true });
    context.drawImage(this.video, 0, 0);
    const { data } = context.getImageData(0, 0, width, height);
    const grey = new Uint8Array(width * height);
    for (let n = 0; n < grey.length; n += 1) {
      // ITU-R BT.601, in 256ths.
      grey[n] = (77 * data[4 * n] + 150 * data[4 * n + 1] + 29 * data[4 * n + 2]) >> 8;
    }
    return grey;
  }
}

// Hands on angular velocity and specific force.
export class Motion {
  constructor(put) {
    Object.assign(this, { put, samples: 0 });
    this.heard = (event) => this.take(event);
    this.asks = typeof globalThis.DeviceMotionEvent?.requestPermission === "function";
    // Apple's engine gives forces the other sign. That it asks for leave tells nothing: Chromium 156 does as well.
    this.sign = navigator.vendor.startsWith("Apple") ? -1 : 1;
  }

  // Asks for leave, where that is needed: at once in answer to a finger, or the browser says no.
  ask() {
    this.answer = this.asks ? DeviceMotionEvent.requestPermission() : "granted";
  }

  async start() {
    if ((await this.answer) !== "granted") throw new Error("access to motion sensors was denied");
    addEventListener("devicemotion", this.heard);
  }

  stop() {
    removeEventListener("devicemotion", this.heard);
  }

  take({ rotationRate: rate, accelerationIncludingGravity: force }) {
    // A device without the sensor says so by null.
    if (rate?.alpha == null || force?.x == null) return;
    const timeNs = nowNs();
    const turning = [rate.alpha, rate.beta, rate.gamma].map((degrees) => degrees * DEGREE);
    const pushing = [force.x, force.y, force.z].map((metres) => metres * this.sign);
    this.put(timeNs, imu(timeNs, "imu", turning, pushing));
    this.samples += 1;
  }
}
