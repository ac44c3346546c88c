// The floor plan: squares from the server, drawn once into tiles; path, rig and places to go back to on top.

const TILE = 256;
const SHADES = ["#dcdcdc", "#000000", "#ff7a00"];
const HERE = "#0046d6";
const LOOP = "#00813e";
// How far the line along an unseen motion reaches to each side.
const UNSEEN_M = 6;
const FOLLOW_M = 9;
const MIN_M_PER_PX = 0.004;
const MAX_M_PER_PX = 1;

export class MapView {
  constructor(canvas) {
    this.canvas = canvas;
    this.context = canvas.getContext("2d");
    this.follow = true;
    this.manual = false;
    this.pose = null;
    this.goBack = [];
    this.points = [];
    this.unseen = null;
    this.loops = [];
    this.forget();
    this.view = { x: 0, y: 0, mPerPx: 0.05 };
    this.pointers = new Map();
    this.pending = false;
    new ResizeObserver(() => this.resize()).observe(canvas);
    canvas.addEventListener("pointerdown", (e) => this.down(e));
    canvas.addEventListener("pointermove", (e) => this.move(e));
    for (const end of ["pointerup", "pointercancel"]) {
      canvas.addEventListener(end, (e) => this.pointers.delete(e.pointerId));
    }
    canvas.addEventListener("wheel", (e) => { e.preventDefault(); this.zoom(e.deltaY < 0 ? 1.25 : 0.8); }, { passive: false });
  }

  forget() {
    this.tiles = new Map();
    this.path = [];
    this.bounds = null;
    this.cellM = 0.2;
  }

  get empty() { return this.bounds === null; }

  /// Takes a piece of the map; laid out as in map.rs.
  take(buffer) {
    const data = new DataView(buffer);
    if (data.byteLength < 16 || data.getUint8(0) !== 1) return;
    if (data.getUint8(1)) this.forget();
    this.cellM = data.getFloat32(4, true);
    const cells = data.getUint32(8, true);
    const points = data.getUint32(12, true);
    let at = 16;
    for (let i = 0; i < cells; i++, at += 6) {
      this.square(data.getInt16(at, true), data.getInt16(at + 2, true), data.getUint8(at + 4));
    }
    for (let i = 0; i < points; i++, at += 8) {
      this.path.push([data.getFloat32(at, true), data.getFloat32(at + 4, true)]);
    }
    this.later();
  }

  square(x, y, shade) {
    const [tx, ty] = [Math.floor(x / TILE), Math.floor(y / TILE)];
    const key = `${tx} ${ty}`;
    let tile = this.tiles.get(key);
    if (!tile) {
      const canvas = document.createElement("canvas");
      canvas.width = canvas.height = TILE;
      tile = { canvas, context: canvas.getContext("2d"), tx, ty };
      this.tiles.set(key, tile);
    }
    tile.context.fillStyle = SHADES[shade] ?? SHADES[0];
    tile.context.fillRect(x - tx * TILE, TILE - 1 - (y - ty * TILE), 1, 1);
    // Far stray squares would make the whole map small.
    if (shade === 0) return;
    const [mx, my] = [x * this.cellM, y * this.cellM];
    const b = this.bounds ??= { left: mx, right: mx, bottom: my, top: my };
    b.left = Math.min(b.left, mx); b.right = Math.max(b.right, mx + this.cellM);
    b.bottom = Math.min(b.bottom, my); b.top = Math.max(b.top, my + this.cellM);
  }

  state(pose, goBack, points, unseen, loops) {
    this.loops = loops;
    this.unseen = unseen;
    this.pose = pose;
    this.goBack = goBack;
    this.points = points;
    this.later();
  }

  /// Follow the rig, or show everything.
  toggle() {
    this.follow = !this.follow;
    this.manual = false;
    this.later();
    return this.follow;
  }

  zoom(factor) {
    const wanted = this.view.mPerPx / factor;
    this.view.mPerPx = Math.min(MAX_M_PER_PX, Math.max(MIN_M_PER_PX, wanted));
    this.zoomed = true;
    if (!this.follow) this.manual = true;
    this.later();
  }

  down(event) {
    this.canvas.setPointerCapture(event.pointerId);
    this.pointers.set(event.pointerId, { x: event.clientX, y: event.clientY });
  }

  move(event) {
    const last = this.pointers.get(event.pointerId);
    if (!last) return;
    const now = { x: event.clientX, y: event.clientY };
    const other = [...this.pointers].find(([id]) => id !== event.pointerId)?.[1];
    if (other) {
      const was = Math.hypot(last.x - other.x, last.y - other.y);
      const is = Math.hypot(now.x - other.x, now.y - other.y);
      if (was > 8) this.zoom(is / was);
    } else {
      this.view.x -= (now.x - last.x) * this.view.mPerPx;
      this.view.y += (now.y - last.y) * this.view.mPerPx;
      this.manual = true;
    }
    this.pointers.set(event.pointerId, now);
    this.later();
  }

  resize() {
    const ratio = window.devicePixelRatio || 1;
    this.canvas.width = Math.max(1, Math.round(this.canvas.clientWidth * ratio));
    this.canvas.height = Math.max(1, Math.round(this.canvas.clientHeight * ratio));
    this.later();
  }

  later() {
    if (this.pending) return;
    this.pending = true;
    requestAnimationFrame(() => { this.pending = false; this.draw(); });
  }

  aim(width, height) {
    if (this.manual) return;
    if (this.follow && this.pose) {
      this.view.x = this.pose.x_m;
      this.view.y = this.pose.y_m;
      if (!this.zoomed) this.view.mPerPx = (2 * FOLLOW_M) / Math.min(width, height);
    } else if (!this.follow && this.bounds) {
      const b = this.bounds;
      this.view.x = (b.left + b.right) / 2;
      this.view.y = (b.bottom + b.top) / 2;
      const fit = Math.max((b.right - b.left + 2) / width, (b.top - b.bottom + 2) / height);
      this.view.mPerPx = Math.min(MAX_M_PER_PX, Math.max(MIN_M_PER_PX, fit));
      this.zoomed = false;
    }
  }

  draw() {
    const ratio = window.devicePixelRatio || 1;
    const c = this.context;
    const [width, height] = [this.canvas.clientWidth, this.canvas.clientHeight];
    this.aim(width, height);
    const { x, y, mPerPx } = this.view;
    const px = (mx, my) => [width / 2 + (mx - x) / mPerPx, height / 2 - (my - y) / mPerPx];
    c.setTransform(ratio, 0, 0, ratio, 0, 0);
    c.clearRect(0, 0, width, height);
    c.imageSmoothingEnabled = false;
    const size = (TILE * this.cellM) / mPerPx;
    for (const tile of this.tiles.values()) {
      const [left, top] = px(tile.tx * TILE * this.cellM, (tile.ty + 1) * TILE * this.cellM);
      if (left > width || top > height || left + size < 0 || top + size < 0) continue;
      c.drawImage(tile.canvas, left, top, size, size);
    }
    this.drawPath(c, px);
    for (const found of this.loops) this.drawLoop(c, px(...found.earlier_m), px(...found.later_m));
    this.goBack.forEach((spot, i) => this.drawSpot(c, px(spot.x_m, spot.y_m), i + 1));
    for (const point of this.points) {
      if (point.position_m) this.drawPoint(c, px(point.position_m[0], point.position_m[1]), point.name);
    }
    if (this.pose && this.unseen?.kind === "shift") this.drawUnseen(c, px, this.pose, this.unseen.direction_in_map);
    if (this.pose) this.drawRig(c, px(this.pose.x_m, this.pose.y_m), this.pose.yaw_rad);
    this.onScale?.(mPerPx);
  }

  drawPath(c, px) {
    if (this.path.length < 2) return;
    c.beginPath();
    for (const [mx, my] of this.path) c.lineTo(...px(mx, my));
    c.lineJoin = c.lineCap = "round";
    c.strokeStyle = "#fff"; c.lineWidth = 7; c.stroke();
    c.strokeStyle = HERE; c.lineWidth = 4; c.stroke();
  }

  /// Two visits of a place that was recognised.
  drawLoop(c, [ex, ey], [lx, ly]) {
    c.beginPath(); c.moveTo(ex, ey); c.lineTo(lx, ly);
    for (const [sx, sy] of [[ex, ey], [lx, ly]]) { c.moveTo(sx + 7, sy); c.arc(sx, sy, 7, 0, 2 * Math.PI); }
    c.strokeStyle = "#fff"; c.lineWidth = 7; c.stroke();
    c.strokeStyle = LOOP; c.lineWidth = 4; c.stroke();
  }

  /// The line along which scans do not see how far the rig has moved.
  drawUnseen(c, px, pose, [dx, dy]) {
    c.save();
    c.beginPath();
    for (const side of [-UNSEEN_M, UNSEEN_M]) c.lineTo(...px(pose.x_m + side * dx, pose.y_m + side * dy));
    c.lineCap = "butt";
    c.strokeStyle = "#fff"; c.lineWidth = 8; c.stroke();
    c.setLineDash([14, 10]);
    c.strokeStyle = SHADES[2]; c.lineWidth = 5; c.stroke();
    c.restore();
  }

  drawSpot(c, [sx, sy], number) {
    c.beginPath(); c.arc(sx, sy, 19, 0, 2 * Math.PI);
    c.fillStyle = SHADES[2]; c.fill();
    c.strokeStyle = "#000"; c.lineWidth = 4; c.stroke();
    this.words(c, String(number), sx, sy + 1, "center", "900 22px system-ui, sans-serif", "#000", null);
  }

  drawPoint(c, [sx, sy], name) {
    c.beginPath(); c.arc(sx, sy, 9, 0, 2 * Math.PI); c.moveTo(sx + 3, sy); c.arc(sx, sy, 3, 0, 2 * Math.PI);
    c.strokeStyle = "#fff"; c.lineWidth = 8; c.stroke();
    c.strokeStyle = HERE; c.lineWidth = 4; c.stroke();
    this.words(c, name, sx + 15, sy, "left", "800 18px system-ui, sans-serif", HERE, "#fff");
  }

  words(c, text, sx, sy, align, font, color, halo) {
    c.font = font; c.textAlign = align; c.textBaseline = "middle";
    if (halo) { c.strokeStyle = halo; c.lineWidth = 5; c.lineJoin = "round"; c.strokeText(text, sx, sy); }
    c.fillStyle = color; c.fillText(text, sx, sy);
  }

  drawRig(c, [sx, sy], yaw) {
    c.save();
    c.translate(sx, sy); c.rotate(-yaw);
    c.beginPath(); c.moveTo(24, 0); c.lineTo(-15, 15); c.lineTo(-7, 0); c.lineTo(-15, -15); c.closePath();
    c.lineJoin = "round";
    c.strokeStyle = "#fff"; c.lineWidth = 8; c.stroke();
    c.strokeStyle = "#000"; c.lineWidth = 4; c.stroke();
    c.fillStyle = HERE; c.fill();
    c.restore();
  }
}
